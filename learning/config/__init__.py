"""The YAML files of learning: what is trained, tuned or evaluated, strict like sim_config.yaml."""

from learning.config.load import load_file

__all__ = ["load_file"]
