"""Mask designs and PSF stacks."""

from pathlib import Path

from simulator.design.load import load_mask
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, stack_folder

__all__ = ["load_mask", "load_psf_stack"]


def load_psf_stack(path: Path | str, *, captured: bool = False) -> PsfStack:
    """Return a PSF stack: the one that a data set used, or the one that a configuration describes.

    Args:
        path: a data set's folder, a folder that ``flatlight psf --output`` wrote, or a ``sim_config.yaml``.
        captured: the stack as a calibration would measure it, errors and all, in place of the true one. A folder has it
            when it was made with ``psf.as_captured`` or ``--as-captured``.

    Raises:
        InputError: when there is no stack at that place.
    """
    path = Path(path)
    if path.suffix in (".yaml", ".yml"):
        from simulator.assembly import Assembly
        from simulator.captured_psf import captured_stack
        from simulator.config import load_config

        assembly = Assembly(load_config(path))
        return captured_stack(assembly) if captured else assembly.psf_stack
    folder = stack_folder(path, captured=captured)
    if captured and not folder.exists():
        raise InputError(
            "captured",
            f"no stack as captured in {folder}; a data set has one with `as_captured: {{}}` in its section psf, "
            "and `flatlight psf --as-captured --output FOLDER` writes one",
        )
    return read_psf_stack(folder)
