"""The YAML files of learning, strict like sim_config.yaml: what is trained, tuned, evaluated, or judged mask by mask."""

from learning.config.evaluation import EvaluateConfig, EvaluationData, MethodConfig, Timing
from learning.config.files import FileSection, load_file
from learning.config.recognition import ClassifierConfig, RecognitionConfig, RecognitionData, evaluation_kind
from learning.config.swap import SwapConfig, WarmStart
from learning.config.training import (
    ActivityLossConfig,
    ActivityNetworkConfig,
    ActivityTrainConfig,
    ClipDataConfig,
    ClipLossConfig,
    DataConfig,
    DenoiserConfig,
    FrameLossConfig,
    LoopConfig,
    LossConfig,
    NetworkConfig,
    OptimiserConfig,
    TrainConfig,
    Video3DLossConfig,
    Video3DTrainConfig,
    VideoNetworkConfig,
    VideoTrainConfig,
    training_kind,
)
from learning.config.tuning import FEWEST_SCENES, TuneConfig, TuneData

__all__ = [
    "FEWEST_SCENES",
    "ActivityLossConfig",
    "ActivityNetworkConfig",
    "ActivityTrainConfig",
    "ClassifierConfig",
    "ClipDataConfig",
    "ClipLossConfig",
    "DataConfig",
    "DenoiserConfig",
    "EvaluateConfig",
    "EvaluationData",
    "FileSection",
    "FrameLossConfig",
    "LoopConfig",
    "LossConfig",
    "MethodConfig",
    "NetworkConfig",
    "OptimiserConfig",
    "RecognitionConfig",
    "RecognitionData",
    "SwapConfig",
    "Timing",
    "TrainConfig",
    "TuneConfig",
    "TuneData",
    "Video3DLossConfig",
    "Video3DTrainConfig",
    "VideoNetworkConfig",
    "VideoTrainConfig",
    "WarmStart",
    "evaluation_kind",
    "load_file",
    "training_kind",
]
