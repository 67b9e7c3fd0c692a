"""What `flatlight tune` is asked for: on which scenes, which methods, at which noise, what is minimised."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from learning.config.load import FileSection
from simulator.config.sections import Range, Section, refusal

FEWEST_SCENES = 32


class TuneData(Section):
    """Scenes on which parameters are tuned; never those of the test."""

    validation: Path = Field(description="folder of the data set")
    split: Literal["validation", "train", "test"] = Field("validation", description="its split that is tuned on")
    scenes: Annotated[int, Range(1, 1_000_000)] = Field(FEWEST_SCENES, description="its first so many samples are used")
    allow_few_scenes: bool = Field(False, description=f"whether fewer than {FEWEST_SCENES} may be used; it is recorded")
    stack: str = Field("nominal", description="PSFs that the methods know: nominal, captured, or a stack's folder")
    train: Path | None = Field(
        None, description="data set whose train split gives pictures their white; null: the one above"
    )

    @model_validator(mode="after")
    def _check_scenes(self) -> TuneData:
        if self.scenes < FEWEST_SCENES and not self.allow_few_scenes:
            text = (
                f"got {self.scenes}, expected at least {FEWEST_SCENES}: what is tuned on fewer fits these and no others; "
                "allow_few_scenes: true lets it be, and says so in the result"
            )
            raise refusal(text, "scenes")
        return self


class AxisSection(Section):
    """Candidates of one parameter instead of the method's own, and how far the search may go beyond them."""

    values: list[float | int | str] | None = Field(None, min_length=1, description="candidates; numbers increase")
    low: Annotated[float, Range(0, 1e300)] | None = Field(None, description="least value; null: the method's own")
    high: Annotated[float, Range(0, 1e300, infinite=True)] | None = Field(
        None, description="greatest; null: the method's own, e.g. 1000 iterations"
    )


class TuneConfig(FileSection):
    """A whole file for `flatlight tune`."""

    output: Path = Field(
        Path("tuned.json"), description="result with all trials; a run that stopped goes on from there"
    )
    data: TuneData = Field(description="scenes")
    methods: list[Literal["cls", "admm"]] = Field(
        default_factory=lambda: ["cls", "admm"], min_length=1, description="classical methods"
    )
    noise_db: list[Annotated[float, Range(0.1, 120, "dB")]] = Field(
        default_factory=lambda: [20.0, 30.0, 40.0, 50.0],
        min_length=1,
        description="PSNR of the measurements, decibels; each level is tuned by itself",
    )
    objective: Literal["both", "picture", "depth"] = Field(
        "both",
        description="minimised error, in units of the constant guess's: depth (RMSE), picture (by PSNR), or their sum",
    )
    search: dict[str, dict[str, AxisSection]] = Field(
        default_factory=dict, description="changes of the search space: method, parameter, candidates and limits"
    )
    seed: Annotated[int, Range(0, 2**63 - 1)] = Field(0, description="of the noise")
    device: Literal["auto", "cpu", "cuda"] = Field("auto", description="auto takes a GPU where there is one")

    @model_validator(mode="after")
    def _check_search(self) -> TuneConfig:
        for name in self.search:
            if name not in self.methods:
                text = f"{name!r} is not tuned here; methods: {', '.join(self.methods)}"
                raise refusal(text, "search", name, on_key=True)
        return self
