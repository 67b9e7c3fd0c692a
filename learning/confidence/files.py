"""Files of calibrated confidences: which method a confidence is of, how well it was found to be calibrated, where it lies."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.checkpoint import FOLDER
from learning.confidence.calibration import DepthConfidence
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.io.json import plain, readable_json

FORMAT, VERSION = "flatlight depth confidence", 1
SUFFIX = ".confidence.json"
_TOLD = {"parameters": "parameters", "psfs": "PSFs"}  # where these of a classical method differ, it is only told


@dataclass(frozen=True)
class ConfidenceFile:
    """A confidence with the method that it is of.

    Attributes:
        confidence: what tells how likely a depth is right.
        method: ``{"sha256": of a checkpoint}``, or ``{"method": name, "parameters": ..., "psfs": fingerprint}`` of a
            classical one.
        checked: by noise level in words, what `learning.confidence.job.Reliability` found on other scenes.
    """

    confidence: DepthConfidence
    method: dict[str, Any]
    checked: dict[str, Any]

    def write(self, path: Path) -> None:
        """Write the file; a StorageError says that it cannot be written."""
        content = {"format": FORMAT, "version": VERSION, "method": self.method, "checked": self.checked}
        write_atomic(path, readable_json(content | {"confidence": plain(self.confidence.record())}))


def read_confidence(path: Path) -> ConfidenceFile:
    """Read what `ConfidenceFile.write` wrote.

    Raises:
        InputError: no such file, a damaged one, or another kind of file.
    """
    cure = "`flatlight confidence` writes such a file"
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}; {cure}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"damaged ({error}); {cure}") from error
    if not isinstance(content, dict) or (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise InputError(path, f"not version {VERSION} of a {FORMAT}; {cure}")
    try:
        return ConfidenceFile(DepthConfidence.read(content["confidence"]), content["method"], content["checked"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"damaged ({type(error).__name__}: {error}); {cure}") from error


def method_identity(record: dict[str, Any]) -> dict[str, Any]:
    """Return what tells a method from others, of the record that `learning.reconstruct.choice` makes of it."""
    if "sha256" in record:
        return {"sha256": record["sha256"]}
    psfs = record["camera"]["psf_fingerprint"]
    return plain({"method": record["method"], "parameters": record["parameters"], "psfs": psfs})


def find_confidence(record: dict[str, Any], told: str | None) -> tuple[DepthConfidence | None, str]:
    """Return the confidence of a method's depths, and where it is from, in words.

    ``told`` is a file, ``none``, or None for the one that lies beside a checkpoint or is shipped for a classical method.

    Raises:
        InputError: a file that cannot be read, or that is of another method.
    """
    if told == "none":
        return None, "not asked for"
    own = method_identity(record)
    if told is not None:
        path = Path(told).expanduser()
    elif "sha256" in own:
        path = Path(record["checkpoint"]).with_suffix(SUFFIX)
    else:
        path = FOLDER / f"{own['method']}{SUFFIX}"
    if told is None and not path.is_file():
        return None, "not known: `flatlight confidence` calibrates it"
    found = read_confidence(path)
    if any(found.method.get(name) != own[name] for name in own.keys() - _TOLD.keys()):
        of = found.method.get("method") or f"a checkpoint {str(found.method.get('sha256'))[:8]}"
        if told is None:
            return None, f"not known: {path.name} is of {of}"
        raise InputError("--confidence", f"got {path}, which is of {of}; give one of this method, or none")
    others = " and ".join(word for name, word in _TOLD.items() if found.method.get(name) != own.get(name))
    origin = found.confidence.origin + (f", with other {others}" if others else "")
    return found.confidence, origin if told is None else f"{origin} ({path})"
