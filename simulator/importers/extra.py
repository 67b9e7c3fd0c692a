"""Loading of packages that only importers need (the extra ``import``), with a word on how to get them."""

from __future__ import annotations

import importlib
from types import ModuleType

from simulator.errors import InputError


class MissingPackageError(InputError):
    """A package that importers need is not installed: no fault of any file."""


def load_extra(module: str, package: str) -> ModuleType:
    """Import a package of the extra ``import``.

    Args:
        module: as Python imports it, such as ``cv2``.
        package: as people know it, such as ``OpenCV``.

    Raises:
        MissingPackageError: when it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        msg = f"this importer needs {package} ({error}): pip install 'flatlight[import]', or in a clone uv run --extra import"
        raise MissingPackageError(msg) from error
