"""The YAML file of an evaluation: test scenes, methods, noise levels, figures."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from learning.config.files import (
    CLASSICAL,
    Classical,
    Count,
    Decibels,
    FileSection,
    Section,
    check_once,
    refuse_folder_names,
)
from simulator.settings import Range
from simulator.validation import refusal


class EvaluationData(Section):
    """The test scenes, and what the methods are told of the camera that saw them."""

    test: str | dict[str, str]
    """folder of the data set, whose camera's gain, offset and exposure are known; several by name,
    {colon: out/colon, stomach: out/stomach}, give one table each and a joint one; <set> in any path stands for the name"""
    split: Literal["train", "validation", "test"] = "test"
    """which of its splits"""
    scenes: Count | None = None
    """only the first so many; null takes all"""
    training: str | None = None
    """folder of the data set that the methods were trained or tuned on: the classical ones assume its PSFs"""
    stack: str = "own"
    """PSFs that methods assume: own (a checkpoint's, else nominal), nominal or captured (of training), or a folder"""
    compare_stacks: list[str] = Field(default_factory=list)
    """further PSFs that every method is given once, e.g. [nominal, captured]"""

    @model_validator(mode="after")
    def _known(self) -> Self:
        wanted = [name for name in (self.stack, *self.compare_stacks) if name in ("nominal", "captured")]
        if wanted and self.training is None:
            text = f"{wanted[0]} PSFs are those of the training data set; name its folder in data.training"
            raise refusal(text)
        if not self.test:
            text = f"got {self.test!r}, expected the folder of a data set, or several by name: {{colon: out/colon}}"
            raise refusal(text, "test")
        refuse_folder_names(() if isinstance(self.test, str) else self.test, "test")
        return self


class MethodConfig(Section):
    """A method: the checkpoints of a network, one per seed, or a classical method with its parameters."""

    name: str = Field(min_length=1)
    """in tables and figures"""
    checkpoints: Annotated[list[str], Field(min_length=1)] | None = None
    """files, one per seed, or names of shipped ones; of clips, a network for stills gives all frames the same"""
    frames: str | None = None
    """of clips: file of a VideoNet, with its own PSFs, whose frames replace the image of a network for stills, so that only
    the depth is that one's"""
    classical: Classical | None = None
    """instead of checkpoints"""
    tuned: str | None = None
    """what `flatlight tune` wrote; parameters of the nearest noise level"""
    parameters: dict[str, Any] | None = None
    """in place of tuned ones and defaults; {} takes the defaults. The denoiser of pnp is a file, or denoiser, the shipped
    one; the initial_estimate of pnp_clips and fista may be a VideoNet's checkpoint"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.checkpoints is None) == (self.classical is None):
            text = f"give either checkpoints (of a network) or classical ({', '.join(CLASSICAL)})"
            raise refusal(text)
        if self.checkpoints is not None:
            check_once(self.checkpoints, "file", "checkpoints")
            if self.tuned is not None or self.parameters is not None:
                text = "tuned and parameters belong to classical methods; leave them out"
                raise refusal(text)
        elif self.frames is not None:
            text = "a classical method has frames of its own; leave it out"
            raise refusal(text, "frames")
        elif self.tuned is None and self.parameters is None:
            text = "a classical method needs tuned (the file of `flatlight tune`), parameters, or both"
            raise refusal(text)
        return self


class Timing(Section):
    """How seconds per scene are measured: one scene at a time, the methods in turn, the median of the repeats."""

    repeats: Annotated[int, Range(0, 1000)] = 5
    """after one warm-up run; 0 skips the timing"""
    noise_db: Decibels | None = None
    """level whose parameters are timed; null: as stored"""


class Drawing(Section):
    """Figures beside the table."""

    montage: Annotated[int, Range(0, 100)] = 4
    """scenes side by side with all estimates; 0: none"""


_SET = "<set>"  # in paths: the name of the data set that is evaluated on


class EvaluateConfig(FileSection):
    """The whole file."""

    name: str = Field(min_length=1)
    """title of the report"""
    output: str
    """folder of results, tables and figures"""
    data: EvaluationData
    methods: list[MethodConfig] = Field(min_length=1)
    reference: str | None = None
    """the one that all others are compared with, scene by scene; null: the first"""
    noise_db: Annotated[list[Decibels], Field(min_length=1)] | None = None
    """further levels at which noise is drawn anew from the noiseless measurements; null: only as stored"""
    ablation_scenes: Count | None = None
    """scenes for noise_db and compare_stacks, the first so many; null: all"""
    depth_bins_cm: list[Annotated[float, Range(0.01, 1e6, "cm")]] | None = None
    """edges of the depth bins of the errors; null: eight bins, even in disparity"""
    group_by: str | None = None
    """key of the scenes' metadata, such as background or event; scores are also reported for each of its values"""
    dark_share: Annotated[float, Range(0, 1)] | None = None
    """also report depth without pixels darker than this share of white; null: not"""
    perceptual: Literal["none", "auto", "lpips"] = "auto"
    """auto: LPIPS where its weight files are and, of clips, ColorVideoVDP where the package cvvdp is; none; lpips: as auto,
    with an error if LPIPS has no files"""
    batch: Count = 8
    """scenes at a time, except where time is taken"""
    seed: int = Field(0, ge=0)
    """of noise that is drawn anew"""
    time: Timing = Timing()
    figures: Drawing = Drawing()
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""
    threads: Count | None = None
    """of torch on the CPU; null leaves them as they are"""

    @property
    def sets(self) -> dict[str, EvaluateConfig]:
        """The same file for each of its data sets alone, by name; without a name where there is only one."""
        test = self.data.test
        return {"": self} if isinstance(test, str) else {name: self._alone(name, test[name]) for name in test}

    def _alone(self, name: str, test: str) -> EvaluateConfig:
        def named(value: Any) -> Any:
            if isinstance(value, dict):
                return {key: named(one) for key, one in value.items()}
            if isinstance(value, list):
                return [named(one) for one in value]
            return value.replace(_SET, name) if isinstance(value, str) else value

        paths = {key: named(getattr(self.data, key)) for key in ("training", "stack", "compare_stacks")}
        methods = [
            method.model_copy(
                update={key: named(getattr(method, key)) for key in ("checkpoints", "frames", "tuned", "parameters")}
            )
            for method in self.methods
        ]
        data = self.data.model_copy(update=paths | {"test": named(test)})
        return self.model_copy(update={"data": data, "methods": methods})

    @model_validator(mode="after")
    def _sense(self) -> Self:
        names = [method.name for method in self.methods]
        check_once(names, "name", "methods", key="name")
        if self.reference is not None and self.reference not in names:
            text = f"got {self.reference!r}, expected one of the methods: {', '.join(names)}"
            raise refusal(text, "reference")
        edges = self.depth_bins_cm
        if edges is not None and (len(edges) < 2 or any(a >= b for a, b in pairwise(edges))):
            text = "expected at least two depths, increasing"
            raise refusal(text, "depth_bins_cm")
        if self.noise_db is not None:
            check_once(self.noise_db, "level", "noise_db")
        if self.data.training is None and any(method.classical for method in self.methods):
            text = "classical methods need data.training, the data set whose PSFs they assume"
            raise refusal(text, "data")
        return self
