"""What a training writes down: metrics.jsonl for programs, TensorBoard for people. Only the leader has one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from learning.training.folder import METRICS, PREVIEW, TENSORBOARD
from simulator.io.files import storage_errors, write_atomic

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter


class Log:
    """The log of a training, from some step on: what was written of later steps is taken away."""

    def __init__(self, folder: Path, step: int) -> None:
        """Open the log.

        Args:
            folder: the training's.
            step: steps done; the training goes on from there.

        Raises:
            StorageError: the folder cannot be written to.
        """
        from torch.utils.tensorboard.writer import SummaryWriter

        self._path, self._preview = folder / METRICS, folder / PREVIEW
        with storage_errors(self._path):
            kept = [line for line in self._lines() if line["step"] <= step]
            write_atomic(self._path, b"".join(_encoded(line) for line in kept))
            self._board: SummaryWriter = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def write(self, step: int, kind: str, values: dict[str, float]) -> None:
        """Write numbers of a step.

        Args:
            step: steps done.
            kind: ``train`` or ``validation``.
            values: by name; finite.

        Raises:
            StorageError: the disk is full.
        """
        with storage_errors(self._path), open(self._path, "ab") as file:
            file.write(_encoded({"step": step, "kind": kind, **values}))
        for name, value in values.items():
            self._board.add_scalar(f"{kind}/{name}", value, step)

    def show(self, step: int, pixels: NDArray[np.uint8]) -> None:
        """Keep a picture ``(h, w, 3)`` of the validation scenes: in TensorBoard, and the newest as a file."""
        from PIL import Image

        from simulator.plots.drawing import png_bytes

        self._board.add_image("validation: truth, estimate, depths", pixels, step, dataformats="HWC")
        write_atomic(self._preview, png_bytes(Image.fromarray(pixels)))

    def close(self) -> None:
        """Finish the files."""
        self._board.close()

    def _lines(self) -> list[dict[str, Any]]:
        if not self._path.exists():
            return []
        found = []
        for text in self._path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(text))
            except ValueError:  # the last line of a process that died while it wrote
                continue
        return found


def _encoded(line: dict[str, Any]) -> bytes:
    return (json.dumps(line) + "\n").encode()
