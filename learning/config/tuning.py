"""The YAML file of a tuning: validation scenes, methods, their search spaces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from learning.config.files import Classical, Decibels, FileSection, Section, check_once
from simulator.settings import Range
from simulator.validation import refusal

FEWEST_SCENES = 32


class TuneData(Section):
    """Scenes on which parameters are tuned; never those of the test."""

    validation: Path
    """folder of the data set"""
    split: Literal["validation", "train", "test"] = "validation"
    """its split that is tuned on"""
    scenes: Annotated[int, Range(1, 1_000_000)] = FEWEST_SCENES
    """its first so many samples are used"""
    allow_few_scenes: bool = False
    """whether fewer than 32 may be used; it is recorded"""
    stack: str = "nominal"
    """PSFs that the methods assume: nominal, captured, or a stack's folder"""
    train: Path | None = None
    """data set whose train split gives images their reference white; null: the one above"""

    @model_validator(mode="after")
    def _check_scenes(self) -> TuneData:
        if self.scenes < FEWEST_SCENES and not self.allow_few_scenes:
            text = (
                f"got {self.scenes}, expected at least {FEWEST_SCENES}: parameters tuned on fewer overfit; "
                "allow_few_scenes: true permits it, and the result says so"
            )
            raise refusal(text, "scenes")
        return self


class AxisSection(Section):
    """Candidates of one parameter instead of the method's own, and how far the search may go beyond them."""

    values: list[float | int | str] | None = Field(None, min_length=1)
    """candidates; numbers increase"""
    low: Annotated[float, Range(0, 1e300)] | None = None
    """least value; null: the method's own"""
    high: Annotated[float, Range(0, 1e300, infinite=True)] | None = None
    """greatest; null: the method's own, e.g. 240 iterations"""


class TuneConfig(FileSection):
    """A whole file for `flatlight tune`."""

    output: Path = Path("tuned.json")
    """result with all trials; a run that stopped goes on from there"""
    data: TuneData
    """scenes"""
    methods: list[Classical] = Field(default_factory=lambda: ["cls", "admm"], min_length=1)
    """classical methods"""
    denoiser: str = "denoiser"
    """prior of pnp and pnp_clips: a file of `flatlight train-denoiser`, or denoiser, the shipped one"""
    noise_db: list[Decibels | Literal["stored"]] = Field(default_factory=lambda: [20.0, 30.0, 40.0, 50.0], min_length=1)
    """PSNR of the measurements, decibels, each tuned by itself; stored takes them with the noise that they have"""
    objective: Literal["both", "image", "depth"] = "both"
    """minimised error, in units of the constant guess's: depth (RMSE), image (by PSNR), or their sum"""
    search: dict[str, dict[str, AxisSection]] = Field(default_factory=dict)
    """changes of the search space: method, parameter, candidates and limits"""
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0
    """of the noise"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes a GPU where there is one"""

    @model_validator(mode="after")
    def _check_methods(self) -> TuneConfig:
        if self.denoiser != "denoiser" and not {"pnp", "pnp_clips"}.intersection(self.methods):
            text = f"only pnp and pnp_clips have one; methods: {', '.join(self.methods)}"
            raise refusal(text, "denoiser", on_key=True)
        check_once(self.methods, "method", "methods")
        check_once(self.noise_db, "level", "noise_db")
        for name in self.search:
            if name not in self.methods:
                text = f"{name!r} is not tuned here; methods: {', '.join(self.methods)}"
                raise refusal(text, "search", name, on_key=True)
            if "denoiser" in self.search[name]:
                text = "a denoiser is not searched: name one in denoiser, tune for each, and compare the results"
                raise refusal(text, "search", name, "denoiser", on_key=True)
            if "initial_estimate" in self.search[name]:
                text = (
                    "an initial estimate is not searched: tune with the default, compare others by `flatlight evaluate`"
                )
                raise refusal(text, "search", name, "initial_estimate", on_key=True)
        return self
