"""The fingerprint: one hash of everything that decides the bytes of a data set's samples.

Two runs with the same fingerprint make the same samples, so a run may resume in a folder only under its fingerprint.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from simulator.dataset.plain import canonical_json, plain
from simulator.files import sha256_file

PACKAGES = (
    "flatlight",
    "numpy",
    "scipy",
    "mitsuba",
    "drjit",
    "OpenEXR",
    "colour-science",
    "pillow",
    "tifffile",
    "trimesh",
)
"""Packages whose version may change a sample's bytes."""
_FREE_IN_PSF = ("check",)  # how closely errors are looked at changes no value
_FREE_IN_DATASET = ("output", "workers", "engine", "train", "validation", "test")  # where, how fast, how many: not what

_LISTED_INPUTS = 100  # more input files than this count as one: dataset.json stays readable


def package_versions() -> dict[str, str]:
    """Return the installed version of every package in ``PACKAGES``, ``absent`` where there is none."""
    versions: dict[str, str] = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "absent"
    return versions


def build_fingerprint(
    config: Mapping[str, Any], backend: str, input_files: Iterable[Path | str] = ()
) -> tuple[str, dict[str, Any]]:
    """Hash what decides the samples' bytes.

    Left out of the configuration: ``name`` and ``dataset.output``, ``workers``, ``engine``, ``train``, ``validation``,
    ``test``, ``psf.check``. Input files count by name and content; their place counts where the configuration names it.

    Args:
        config: the configuration as a dict, as ``Config.model_dump()`` gives it.
        backend: the renderer's variant, for example ``llvm_ad_rgb``.
        input_files: files whose contents decide samples: imported frames, measured PSFs, plugins' own code.

    Returns:
        64 hexadecimal digits, and the parts that were hashed (plain JSON, kept in ``dataset.json``).

    Raises:
        InputError: an input file cannot be read, or a value of the configuration has no JSON form.
    """
    kept = {key: value for key, value in config.items() if key != "name"}
    if isinstance(kept.get("dataset"), Mapping):
        kept["dataset"] = {key: value for key, value in kept["dataset"].items() if key not in _FREE_IN_DATASET}
    if isinstance(kept.get("psf"), Mapping):
        kept["psf"] = {key: value for key, value in kept["psf"].items() if key not in _FREE_IN_PSF}
    inputs: dict[str, str] = {}
    for path in map(Path, input_files):
        name, copies = path.name, 1
        while name in inputs:
            copies += 1
            name = f"{path.name}#{copies}"
        inputs[name] = sha256_file(path)
    if len(inputs) > _LISTED_INPUTS:
        inputs = {f"{len(inputs)} files": hashlib.sha256(canonical_json(inputs)).hexdigest()}
    versions = package_versions()
    if isinstance(kept.get("render"), Mapping) and kept["render"].get("denoise"):
        versions["pyoidn"] = metadata.version("pyoidn")
    parts = plain({"backend": backend, "config": kept, "inputs": inputs, "versions": versions}, "configuration")
    return hashlib.sha256(canonical_json(parts)).hexdigest(), parts


def difference(old_parts: Mapping[str, Any], new_parts: Mapping[str, Any]) -> str:
    """Say in one line per value what changed between the parts of two fingerprints; empty when nothing did.

    Example:
        >>> old = {"config": {"camera": {"noise": {"psnr_db": 40}}}, "backend": "llvm_ad_rgb"}
        >>> new = {"config": {"camera": {"noise": {"psnr_db": 30}}}, "backend": "llvm_ad_rgb"}
        >>> difference(old, new)
        'camera.noise.psnr_db: 40 -> 30'
    """
    old, new = _flat(old_parts), _flat(new_parts)
    lines = []
    for key in sorted(old.keys() | new.keys()):
        before, after = old.get(key, "(absent)"), new.get(key, "(absent)")
        if canonical_json(before) != canonical_json(after):  # 1, 1.0 and True are equal in Python only
            texts = [_short(value) for value in (before, after)]
            if texts[0] == texts[1]:
                texts = [repr(before), repr(after)]
            lines.append(f"{key.removeprefix('config.')}: {texts[0]} -> {texts[1]}")
    return "\n".join(lines)


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping) and value:
        items = value.items()
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        items = enumerate(value)
    else:
        return {prefix: value}
    flat: dict[str, Any] = {}
    for key, item in items:
        flat |= _flat(item, f"{prefix}.{key}" if prefix else str(key))
    return flat


def _short(value: Any) -> str:
    text = str(value)
    if len(text) == 64 and set(text) <= set("0123456789abcdef"):
        return text[:12]  # the start of a hash tells hashes apart
    return text if len(text) <= 100 else text[:97] + "..."
