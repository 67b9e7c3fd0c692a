"""The trained networks that come with Flatlight: one small file each."""

from __future__ import annotations

from pathlib import Path

from simulator.errors import InputError

FOLDER = Path(__file__).parent / "checkpoints"
_FIRST = "flatnet3d"  # where several fit


def shipped_checkpoints() -> dict[str, Path]:
    """Return the files by name, that of the best network first; empty where there are none."""
    files = {path.stem: path for path in sorted(FOLDER.glob("*.safetensors"))}
    return dict(sorted(files.items(), key=lambda item: (item[0] != _FIRST, item[0])))


def find_checkpoint(text: str) -> Path:
    """Return the file of a checkpoint, named by its path or, where it is shipped, by its name.

    Raises:
        InputError: neither a file nor a shipped checkpoint's name.
    """
    path = Path(text).expanduser()
    if path.is_file():
        return path
    shipped = shipped_checkpoints()
    if text in shipped:
        return shipped[text]
    known = (
        f"a shipped checkpoint ({', '.join(shipped)})"
        if shipped
        else "the name of a shipped one, of which there are none"
    )
    msg = f"--checkpoint: got {text!r}, expected an existing file of `flatlight train`, or {known}"
    raise InputError(msg)
