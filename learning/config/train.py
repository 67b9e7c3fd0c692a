"""The schema of a training's YAML file: data, network, loss, optimiser, and how long."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from learning.config.load import FileSection
from simulator.config.sections import Range, Section, refusal

Weight = Annotated[float, Range(0, 1e6, below="a weight is not negative")]
Decibels = Annotated[float, Range(1, 120, "dB")]


class DataConfig(Section):
    """What is learned from."""

    train: str = Field(description="folder of the data set whose train split is learned from", min_length=1)
    validation: str | None = Field(
        default=None, description="folder of the data set whose validation split is measured; the same when left out"
    )
    stack: str = Field(
        default="nominal",
        description="PSFs that the inversion knows: nominal, captured (psf.as_captured), or the folder of a stack",
        min_length=1,
    )
    noise_db: tuple[Decibels, Decibels] | None = Field(
        default=None,
        description="peak signal-to-noise ratios, least and greatest, between which noise is drawn anew for every example; "
        "the stored measurement when left out",
    )
    cache: bool | str = Field(
        default=True,
        description="keep decoded samples, which then cost no time: in Flatlight's cache folder (true), in a folder, or not",
    )
    workers: Annotated[int, Range(0, 256)] | Literal["auto"] = Field(
        default="auto", description="processes that read examples; 0 reads between the steps"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.noise_db is not None and self.noise_db[0] > self.noise_db[1]:
            text = f"got {self.noise_db[0]:g} before {self.noise_db[1]:g}; the least comes first: swap them?"
            raise refusal(text, "noise_db")
        return self


class NetworkConfig(Section):
    """Which network, and how big: a size, and what differs from it."""

    name: Literal["flatnet3d", "flatnet2d"] = Field(
        default="flatnet3d", description="inversion at all depths of the stack, or at the hyperfocal one only"
    )
    size: Literal["thesis", "compact", "tiny"] = Field(
        default="compact", description="the numbers below that are left out"
    )
    filters: Annotated[int, Range(1, 1024)] | None = Field(
        default=None, description="channels of the U-Net's first level; each further one has twice as many"
    )
    levels: Annotated[int, Range(1, 8)] | None = Field(default=None, description="levels of the U-Net")
    attention: bool | None = Field(default=None, description="attention gates on the U-Net's skips")
    stem: Annotated[int, Range(1, 8)] | None = Field(
        default=None, description="pixels per side that the U-Net takes as one: 2 makes it four times cheaper"
    )
    strength: Annotated[float, Range(1e-9, 1e6)] | None = Field(
        default=None, description="initial lambda of the inversion, as a multiple of the PSF's mean spectral power"
    )
    floor: Annotated[float, Range(0, 1e6)] | None = Field(
        default=None, description="initial response of the inversion's P at frequency zero; 0 is the Laplacian alone"
    )

    @property
    def changes(self) -> dict[str, Any]:
        """What differs from the size; see `learning.models.build_network`."""
        return {
            key: value for key, value in self.model_dump().items() if key not in ("name", "size") and value is not None
        }


class LossConfig(Section):
    """What is made small: the sum of the weighted terms."""

    intensity: Literal["mse", "l1"] = Field(default="l1", description="error of the sRGB codes")
    perceptual: Literal["none", "vgg", "random_vgg"] = Field(
        default="none",
        description="error of VGG-19 features: of trained weights (a file that must be there), or random ones",
    )
    intensity_weight: Weight = Field(default=1.0, description="of the error of the codes")
    perceptual_weight: Weight = Field(default=0.1, description="of the error of the features, where there are any")
    depth_weight: Weight = Field(default=1.0, description="of the mean absolute error of the disparity, 0..1")
    perceptual_seed: Annotated[int, Range(0, 2**31 - 1)] = Field(
        default=0, description="of random_vgg: trainings with other seeds are to make the same loss small"
    )
    invalid_depth: bool = Field(
        default=False,
        description="whether pixels where nothing was seen count in the error of the disparity, as far ones",
    )


class OptimiserConfig(Section):
    """Adam (AdamW where weights decay), and its learning rate over the steps."""

    learning_rate: Annotated[float, Range(1e-9, 10, below="a learning rate is positive")] = Field(
        default=1e-3, description="the greatest one"
    )
    schedule: Literal["cosine", "constant"] = Field(
        default="cosine", description="after the warm-up: down to zero along half a cosine, or constant"
    )
    warm_up: Annotated[float, Range(0, 0.9)] = Field(
        default=0.05, description="share of the steps over which the learning rate rises from zero"
    )
    weight_decay: Annotated[float, Range(0, 1)] = Field(
        default=0.0,
        description="decay of the convolutions' weights per unit of learning rate (Loshchilov and Hutter 2019)",
    )
    gradient_clip: Annotated[float, Range(1e-9, 1e9)] | None = Field(
        default=None, description="greatest norm of the gradient; longer ones are shortened to it"
    )


class TrainConfig(FileSection):
    """One training."""

    name: str = Field(description="of the method in tables and figures", min_length=1)
    output: str = Field(description="folder of the checkpoints, the metrics and the state to go on from", min_length=1)
    seed: Annotated[int, Range(0, 2**31 - 1)] = Field(
        default=0, description="of the initial weights, the order of the examples and their noise"
    )
    data: DataConfig
    network: NetworkConfig = Field(default_factory=NetworkConfig)
    start: str | None = Field(
        default=None,
        description="checkpoint (.safetensors) of a network of the same kind to begin with, for fine-tuning",
    )
    loss: LossConfig = Field(default_factory=LossConfig)
    optimiser: OptimiserConfig = Field(default_factory=OptimiserConfig)
    steps: Annotated[int, Range(1, 10**9)] = Field(
        description="batches to learn from; may be raised later, where a cosine's learning rate then starts over higher up: "
        "every change is recorded"
    )
    batch: Annotated[int, Range(1, 65536)] = Field(
        default=8, description="examples in a step, of all processes together"
    )
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        default="auto",
        description="of the U-Net: bfloat16 (autocast) is faster where the processor has it; auto takes it on CUDA only. "
        "The inversion and the loss stay float32",
    )
    device: Literal["auto", "cpu", "cuda"] = Field(default="auto", description="auto takes CUDA where there is some")
    validate_every: Annotated[int, Range(1, 10**9)] = Field(default=500, description="steps between validations")
    log_every: Annotated[int, Range(1, 10**9)] = Field(
        default=50, description="steps whose mean is one line of metrics.jsonl and one point in TensorBoard"
    )
    checkpoint_every_s: Annotated[float, Range(0, 1e6, "s")] = Field(
        default=60.0, description="seconds between states that are saved to go on from"
    )
