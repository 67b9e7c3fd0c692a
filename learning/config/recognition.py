"""The YAML file of an evaluation of classifiers: test captures, classifiers, noise levels, figures."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from learning.config.evaluation import EvaluateConfig
from learning.config.files import Count, Decibels, FileSection, Section, check_once
from simulator.validation import refusal


class ClassifierConfig(Section):
    """A classifier: its checkpoints, one per seed."""

    name: str = Field(min_length=1)
    """in tables and figures"""
    checkpoints: list[str] = Field(min_length=1)
    """files, one per seed, or names of shipped ones"""
    test: str | None = None
    """folder of another data set that it is tested on, such as the same clips through another shutter; null: that of all"""


class RecognitionData(Section):
    """The test captures."""

    test: str = Field(min_length=1)
    """folder of the data set"""
    split: Literal["train", "validation", "test"] = "test"
    """which split, of every data set here"""
    clips: Count | None = None
    """only the first so many; null takes all"""
    backwards: str | None = None
    """folder of a data set with the same clips reversed in time (scene: {source: samples, backwards: true}): what becomes of
    those that the reference classifies correctly?"""


class RecognitionConfig(FileSection):
    """The whole file."""

    name: str = Field(min_length=1)
    """title of the report"""
    output: str
    """folder of results, tables and figures"""
    data: RecognitionData
    classifiers: list[ClassifierConfig] = Field(min_length=1)
    reference: str | None = None
    """the one that all others are compared with; null: the first"""
    ceiling: str | None = None
    """the one whose accuracy is 100 % in the column "of the ceiling", such as that of the frames of a lens; null: none"""
    noise_db: Annotated[list[Decibels], Field(min_length=1)] | None = None
    """further levels at which noise is drawn anew from the noiseless measurements; null: only as stored"""
    batch: Count = 8
    """captures at a time"""
    seed: int = Field(0, ge=0)
    """of noise that is drawn anew, and of the intervals"""
    timed: int = Field(8, ge=0, le=1000)
    """captures used for timing, one at a time; 0: none"""
    shown: int = Field(6, ge=0, le=100)
    """captures on the sheet, with what their slivers show and what is said of them; 0: no sheet"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""
    threads: Count | None = None
    """of torch on the CPU; null leaves them as they are"""

    @model_validator(mode="after")
    def _sense(self) -> Self:
        for at, one in enumerate(self.classifiers):
            check_once(one.checkpoints, "file", "classifiers", at, "checkpoints")
        names = [one.name for one in self.classifiers]
        check_once(names, "name", "classifiers", key="name")
        for key in ("reference", "ceiling"):
            wanted = getattr(self, key)
            if wanted is not None and wanted not in names:
                text = f"got {wanted!r}, expected one of the classifiers: {', '.join(names)}"
                raise refusal(text, key)
        if self.noise_db is not None:
            check_once(self.noise_db, "level", "noise_db")
        return self


def evaluation_kind(data: dict[str, Any]) -> type[EvaluateConfig] | type[RecognitionConfig]:
    """Return what an evaluation's file must be: one that lists classifiers is of these."""
    return RecognitionConfig if "classifiers" in data else EvaluateConfig
