"""The file of `flatlight evaluate`: which methods, on which scenes, at which noise, and what is drawn of it."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from learning.config.load import FileSection
from simulator.config.sections import Range, Section, refusal

Decibels = Annotated[float, Range(0, 100, "dB")]
Count = Annotated[int, Range(1, 10_000_000, below="at least one")]


class EvaluationData(Section):
    """The scenes that decide, and what the methods are told of the camera that saw them."""

    test: str = Field(description="folder of the data set; its camera's gain, offset and exposure are known")
    split: Literal["train", "validation", "test"] = Field(default="test", description="which of its splits")
    scenes: Count | None = Field(default=None, description="only the first so many; null takes all")
    training: str | None = Field(
        default=None,
        description="folder of the data set that the methods were trained or tuned on: the classical ones believe its PSFs",
    )
    stack: str = Field(
        default="own",
        description="the PSFs that methods believe: own (a checkpoint's; of classical methods nominal), nominal or captured "
        "(of the training data set), or the folder of a stack",
    )
    compare_stacks: list[str] = Field(
        default_factory=list, description="further PSFs that every method is given once, e.g. [nominal, captured]"
    )

    @model_validator(mode="after")
    def _known(self) -> Self:
        wanted = [name for name in (self.stack, *self.compare_stacks) if name in ("nominal", "captured")]
        if wanted and self.training is None:
            text = f"{wanted[0]} PSFs are those of the training data set; name its folder in data.training"
            raise refusal(text)
        return self


class MethodConfig(Section):
    """A method: the checkpoints of a network, one per seed, or a classical method with its parameters."""

    name: str = Field(description="in tables and figures", min_length=1)
    checkpoints: list[str] | None = Field(default=None, description="files, one per seed")
    classical: Literal["cls", "admm"] | None = Field(default=None, description="instead of checkpoints")
    tuned: str | None = Field(
        default=None, description="what `flatlight tune` wrote; parameters of the nearest noise level"
    )
    parameters: dict[str, Any] | None = Field(default=None, description="instead of tuned; {} takes the defaults")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.checkpoints is None) == (self.classical is None):
            text = "give either checkpoints (of a network) or classical (cls, admm)"
            raise refusal(text)
        if self.checkpoints is not None:
            if not self.checkpoints or len(set(self.checkpoints)) < len(self.checkpoints):
                text = "expected at least one file, each of them once"
                raise refusal(text, "checkpoints")
            if self.tuned is not None or self.parameters is not None:
                text = "tuned and parameters belong to classical methods; leave them out"
                raise refusal(text)
        elif (self.tuned is None) == (self.parameters is None):
            text = "a classical method needs either tuned (the file of `flatlight tune`) or parameters"
            raise refusal(text)
        return self


class Timing(Section):
    """How seconds per scene are taken: one scene at a time, the methods by turns, the median of the repeats."""

    repeats: Annotated[int, Range(0, 1000)] = Field(
        default=5, description="after one that is not counted; 0 takes no times"
    )
    noise_db: Decibels | None = Field(default=None, description="level whose parameters are timed; null: as stored")


class Drawing(Section):
    """Figures beside the table."""

    montage: Annotated[int, Range(0, 100)] = Field(
        default=4, description="scenes side by side with all estimates; 0: none"
    )


class EvaluateConfig(FileSection):
    """The whole file."""

    name: str = Field(description="title of the report", min_length=1)
    output: str = Field(description="folder of results, tables and figures")
    data: EvaluationData
    methods: list[MethodConfig] = Field(min_length=1)
    noise_db: list[Decibels] | None = Field(
        default=None,
        description="further levels at which noise is drawn anew from the noiseless measurements; null: only as stored",
    )
    ablation_scenes: Count | None = Field(
        default=None, description="scenes for noise_db and compare_stacks, the first so many; null: all"
    )
    depth_bins_cm: list[Annotated[float, Range(0.01, 1e6, "cm")]] | None = Field(
        default=None, description="edges of the depths by which errors are parted; null: eight, even in disparity"
    )
    dark_share: Annotated[float, Range(0, 1)] | None = Field(
        default=None, description="also report depth without pixels darker than this share of white; null: not"
    )
    perceptual: Literal["none", "auto", "lpips"] = Field(
        default="auto", description="LPIPS: none, where its weight files are (auto), or always, an error without them"
    )
    batch: Count = Field(default=8, description="scenes at a time, except where time is taken")
    seed: int = Field(default=0, description="of noise that is drawn anew", ge=0)
    time: Timing = Timing()
    figures: Drawing = Drawing()
    device: Literal["auto", "cpu", "cuda"] = Field(default="auto", description="auto takes CUDA where there is some")
    threads: Count | None = Field(default=None, description="of torch on the CPU; null leaves them as they are")

    @model_validator(mode="after")
    def _sense(self) -> Self:
        names = [method.name for method in self.methods]
        for at, name in enumerate(names):
            if name in names[:at]:
                text = f"{name!r} is the name of two methods"
                raise refusal(text, "methods", at, "name")
        edges = self.depth_bins_cm
        if edges is not None and (len(edges) < 2 or any(a >= b for a, b in pairwise(edges))):
            text = "expected at least two depths, increasing"
            raise refusal(text, "depth_bins_cm")
        levels = self.noise_db
        if levels is not None and (not levels or len(set(levels)) < len(levels)):
            text = "expected at least one level, each of them once"
            raise refusal(text, "noise_db")
        if self.data.training is None and any(method.classical for method in self.methods):
            text = "classical methods need data.training, the data set whose PSFs they believe"
            raise refusal(text, "data")
        return self
