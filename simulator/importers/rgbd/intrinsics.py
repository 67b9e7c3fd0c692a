"""The camera of a data set of pictures with depth, from the configuration or from a file beside the pictures."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, RootModel, ValidationError

from simulator.errors import InputError
from simulator.importers.rgbd.camera_models import Lens, OpencvFisheye, Pinhole, Scaramuzza, pinhole_of
from simulator.io.files import read_text
from simulator.validation import find_problems, validate

Intrinsics = Annotated[Pinhole | OpencvFisheye | Scaramuzza, Field(discriminator="type")]
_MAX_BYTES = 65536
FILE_NAMES = ("camera_intrinsics.txt", "cam.txt")


class _File(RootModel[Intrinsics]):
    """A file that holds what ``intrinsics`` would."""


def read_intrinsics(path: Path) -> Lens:
    """Read a camera from a file.

    Args:
        path: ``.yaml``, ``.yml`` or ``.json`` with the keys of ``intrinsics``; anything else is text with the nine numbers of
            the camera matrix row by row, parted by commas or blanks (EndoSLAM's ``camera_intrinsics.txt``, SimCol3D's
            ``cam.txt``).

    Raises:
        InputError: naming the file, when it cannot be read or describes no camera.
    """
    text = read_text(path, "the numbers of one camera", _MAX_BYTES)
    if path.suffix.lower() not in {".yaml", ".yml", ".json"}:
        words = re.split(r"[\s,;]+", text.strip())
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            numbers = np.zeros(0)
        if numbers.size != 9:
            msg = f"{path} holds {text[:60]!r}; expected nine numbers, the camera matrix fx, 0, cx, 0, fy, cy, 0, 0, 1"
            raise InputError(msg)
        return pinhole_of(numbers.reshape(3, 3), str(path))
    import yaml

    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        msg = f"{path} is not valid YAML: {' '.join(str(error).split())}"
        raise InputError(msg) from error
    try:
        return validate(_File, data).root
    except ValidationError as error:
        problems = "; ".join(map(str, find_problems(error, _File, data)))
        msg = f"{path}: {problems}"
        raise InputError(msg) from error


def nearest_file(root: Path, folder: Path) -> Path | None:
    """Return the file with intrinsics in a folder, or in those above it up to the root."""
    for place in (folder, *folder.parents):
        for name in FILE_NAMES:
            if (place / name).is_file():
                return place / name
        if place == root:
            break
    return None
