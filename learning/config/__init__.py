"""The YAML files of learning, strict like sim_config.yaml: what is trained, tuned, evaluated, or judged mask by mask."""

from learning.config.evaluation import EvaluateConfig, EvaluationData, MethodConfig, Timing
from learning.config.files import FileSection, load_file
from learning.config.swap import SwapConfig, WarmStart
from learning.config.training import (
    DataConfig,
    DenoiserConfig,
    LoopConfig,
    LossConfig,
    NetworkConfig,
    OptimiserConfig,
    TrainConfig,
)
from learning.config.tuning import FEWEST_SCENES, TuneConfig, TuneData

__all__ = [
    "FEWEST_SCENES",
    "DataConfig",
    "DenoiserConfig",
    "EvaluateConfig",
    "EvaluationData",
    "FileSection",
    "LoopConfig",
    "LossConfig",
    "MethodConfig",
    "NetworkConfig",
    "OptimiserConfig",
    "SwapConfig",
    "Timing",
    "TrainConfig",
    "TuneConfig",
    "TuneData",
    "WarmStart",
    "load_file",
]
