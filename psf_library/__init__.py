"""Mask designs and PSF stacks."""

from pathlib import Path

from simulator.assemble import load_mask
from simulator.dataset.psf_files import read_psf_stack
from simulator.optics.psf_stack import PsfStack

__all__ = ["load_mask", "load_psf_stack"]


def load_psf_stack(path: Path | str) -> PsfStack:
    """Return a PSF stack: the one that a data set used, or the one that a configuration describes.

    Args:
        path: a data set's folder, a folder that ``flatlight psf --output`` wrote, or a ``sim_config.yaml``.

    Raises:
        InputError: when there is no stack at that place.
    """
    path = Path(path)
    if path.suffix in (".yaml", ".yml"):
        from simulator.assemble import build_psf_stack
        from simulator.config import load_config

        return build_psf_stack(load_config(path))
    return read_psf_stack(path / "psf" if (path / "psf").is_dir() else path)
