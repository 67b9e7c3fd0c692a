"""The typed form of sim_config.yaml: its schema, strict loading, and errors that name file, line and column."""

from simulator.config.load import (
    ConfigError,
    config_from_dict,
    default_config_text,
    dump,
    json_schema,
    load_config,
)
from simulator.config.schema import Config

__all__ = ["Config", "ConfigError", "config_from_dict", "default_config_text", "dump", "json_schema", "load_config"]
