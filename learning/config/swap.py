"""The YAML file that judges masks by reconstruction: camera, masks, scenes, methods."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from learning.config.files import Count, Decibels, FileSection, OfStills, Section, check_once, refuse_folder_names
from learning.config.training import LossConfig, NetworkOptimiserConfig
from learning.simulate import Augmentation
from simulator.settings import Range
from simulator.validation import refusal


class SeenAgain(Section):
    """Whose scenes all masks see: data sets of Flatlight; nothing is rendered."""

    train: str = Field(min_length=1)
    """folder of the data set whose train and validation splits are for training and tuning"""
    test: str | None = None
    """folder of the data set whose test split decides; the same when left out"""
    train_scenes: Count = 1000
    """the first so many of the train split"""
    validation_scenes: Count = 64
    """the first so many of the validation split; methods are tuned on 32 of them"""
    test_scenes: Count = 64
    """the first so many of the test split"""


class WarmStart(Section):
    """A trained network that is fine-tuned for each mask; it has the checkpoint's architecture."""

    init_from: str = Field(min_length=1)
    """checkpoint (.safetensors) or name of a shipped one"""
    steps: Annotated[int, Range(0, 10**9)] = 300
    """batches to fine-tune on, for each mask; 0 only replaces its PSFs by the mask's"""
    batch: Annotated[int, Range(1, 65536)] = 8
    """examples in a step"""
    augment: Augmentation | None = Augmentation()
    """scenes changed and re-simulated through the camera with the mask, for every example; null: as stored"""
    loss: LossConfig = LossConfig()
    optimiser: NetworkOptimiserConfig = NetworkOptimiserConfig()
    validate_every: Annotated[int, Range(1, 10**9)] = 100
    """steps between validations, by which the best one is chosen"""


class SwapConfig(FileSection):
    """Masks judged by what is reconstructed: one camera, the same scenes and light, the same methods."""

    name: str = Field(min_length=1)
    """title of the report"""
    output: str = Field(min_length=1)
    """folder of the data sets, trainings, evaluation and report"""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of trainings, tuning and noise that is drawn anew"""
    config: str = Field(min_length=1)
    """configuration (sim_config.yaml) whose camera and depths all masks share"""
    settings: list[str] = Field(default_factory=list)
    """what differs from it for all masks, KEY=VALUE each, as for --set"""
    test_settings: list[str] = Field(default_factory=list)
    """what else differs in the test: PSFs that no method is told of, e.g. psf.model=exact"""
    masks: dict[str, dict[str, Any]] = Field(min_length=1)
    """by name, each as in camera.mask; the others are compared with the first one"""
    scenes: SeenAgain
    network: WarmStart | None = None
    """null: classical methods only"""
    tuned: list[OfStills] = Field(default_factory=lambda: ["cls"])
    """classical methods whose parameters are tuned for each mask"""
    untuned: list[OfStills] = Field(default_factory=list)
    """classical methods with their default parameters"""
    noise_db: list[Decibels] = Field(default_factory=list)
    """further noise levels: white noise of the same PSNR for all masks, whatever light they pass"""
    perceptual: Literal["none", "auto", "lpips"] = "none"
    """see `EvaluateConfig`"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""

    @model_validator(mode="after")
    def _sense(self) -> Self:
        refuse_folder_names(self.masks, "masks")
        for key in ("settings", "test_settings"):
            for at, text in enumerate(getattr(self, key)):
                if (name := text.partition("=")[0].strip()) == "camera.mask" or name.split(".")[0] in (
                    "dataset",
                    "scene",
                ):
                    text = f"got {name}, which masks and scenes decide; leave it out"
                    raise refusal(text, key, at)
        for key, each in (("tuned", "method"), ("untuned", "method"), ("noise_db", "level")):
            check_once(getattr(self, key), each, key)
        if self.network is None and not self.tuned + self.untuned:
            text = "nothing reconstructs: give network, or a classical method in tuned or untuned"
            raise refusal(text)
        return self
