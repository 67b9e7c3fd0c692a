"""Which camera each method is told of: the numbers of the one that saw the test scenes, the PSFs that the method believes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from learning.capture import CaptureModel, capture_model
from learning.display import measure_white
from learning.evaluation.outcome import OWN
from learning.evaluation.roster import Entry
from simulator.arrays import to_numpy
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack

_WHITES_ALIKE = 1e-6


class Cameras:
    """The cameras of an evaluation.

    Attributes:
        test: the camera of the test data set with its own PSFs, and the evaluation's white.
    """

    def __init__(
        self, test: Dataset, training: Path | None, entries: Sequence[Entry], folder: Callable[[str], Path] = Path
    ) -> None:
        """Find the white that all methods share.

        Args:
            test: the split that decides.
            training: folder of the data set that the methods were trained or tuned on.
            entries: all methods.
            folder: makes a path of the name of a stack's folder.

        Raises:
            InputError: methods whose pictures have different whites, or a data set that cannot be read.
        """
        self._training, self._folder = training, folder
        self._stacks: dict[str, PsfStack] = {}
        self._nominal: CaptureModel | None = None
        self.test = capture_model(test, white=self._white(entries))

    def believed(self, entry: Entry, name: str) -> CaptureModel:
        """Return the camera that a method is told of.

        Args:
            entry: the method.
            name: ``own``, ``nominal``, ``captured``, or the folder of a stack.

        Raises:
            InputError: no such stack, or one of another camera.
        """
        try:
            known = self._known() if entry.capture is None else entry.capture
            if name != OWN:
                known = known.with_stack(self._stack(name))
            return self.test.believed(known)
        except InputError as error:
            msg = f"{entry.name}: {error}"
            raise InputError(msg) from error

    def _known(self) -> CaptureModel:
        """Return the camera of the training data, by which methods are told that bring none."""
        assert self._training is not None  # the configuration sees to it
        if self._nominal is None:
            self._nominal = capture_model(open_dataset(self._training, "train"), white=self.test.white)
        return self._nominal

    def _stack(self, name: str) -> PsfStack:
        if name not in self._stacks:
            if name in ("nominal", "captured"):
                assert self._training is not None  # the configuration sees to it
                self._stacks[name] = capture_model(open_dataset(self._training, "train"), name).stack
            else:
                self._stacks[name] = read_psf_stack(self._folder(name))
        return self._stacks[name]

    def _white(self, entries: Sequence[Entry]) -> float:
        whites = {entry.name: entry.capture.white for entry in entries if entry.capture is not None}
        if not whites:
            assert self._training is not None
            return measure_white(open_dataset(self._training, "train"))
        first = next(iter(whites.values()))
        for name, white in whites.items():
            if abs(white - first) > _WHITES_ALIKE * first:
                msg = (
                    f"methods: the pictures of {name} show a radiance of {white:g} as white, those of {next(iter(whites))} "
                    f"{first:g}, so their scores cannot stand in one table; train them with one white"
                )
                raise InputError(msg)
        return first


def camera_identity(capture: CaptureModel) -> str:
    """Return a hash of all that a camera model holds."""
    arrays = (capture.stack.values, capture.stack.depths_m, capture.irradiance, capture.offset, capture.scene_to_camera)
    parts = [sha256_bytes(np.ascontiguousarray(to_numpy(array)).tobytes()) for array in arrays]
    numbers = (capture.stack.pixel_pitch_m, capture.gain, capture.white, *capture.sensor_shape, *capture.scene_shape)
    return sha256_bytes(canonical_json([parts, numbers, capture.stack.channels]))
