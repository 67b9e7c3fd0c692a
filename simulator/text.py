"""Reading small text files that somebody else wrote."""

from __future__ import annotations

from pathlib import Path

from simulator.errors import InputError

MAX_BYTES = 16 << 20


def read_text(path: Path, holds: str, max_bytes: int = MAX_BYTES) -> str:
    """Return the text of a small file, without a byte-order mark.

    Args:
        path: the file.
        holds: what it should hold, for the messages, such as ``a table of wavelengths``.
        max_bytes: more than this is another file.

    Raises:
        InputError: when it cannot be read, is no UTF-8 text or too large.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(max_bytes + 1)
        if len(raw) > max_bytes:
            msg = f"{path}: larger than {max_bytes >> 10} KiB, expected {holds}; is this the right file?"
            raise InputError(msg)
        return raw.decode("utf-8-sig")
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
    except UnicodeDecodeError as error:
        msg = f"{path}: not UTF-8 text (byte 0x{error.object[error.start]:02x}); expected {holds}"
        raise InputError(msg) from error
