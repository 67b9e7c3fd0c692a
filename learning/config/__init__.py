"""The YAML files of learning, strict like sim_config.yaml: what is trained, tuned, evaluated, or judged mask by mask."""

from learning.config.evaluation import EvaluateConfig, EvaluationData, MethodConfig, Timing
from learning.config.files import FileSection, load_file
from learning.config.swap import SwapConfig, WarmStart
from learning.config.training import (
    ClipLossConfig,
    DataConfig,
    DenoiserConfig,
    LoopConfig,
    LossConfig,
    NetworkConfig,
    OptimiserConfig,
    TrainConfig,
    VideoNetworkConfig,
    VideoTrainConfig,
    training_kind,
)
from learning.config.tuning import FEWEST_SCENES, TuneConfig, TuneData

__all__ = [
    "FEWEST_SCENES",
    "ClipLossConfig",
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
    "VideoNetworkConfig",
    "VideoTrainConfig",
    "WarmStart",
    "load_file",
    "training_kind",
]
