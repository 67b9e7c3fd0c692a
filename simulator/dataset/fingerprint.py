"""The fingerprint: one hash of everything that decides the bytes of a data set's samples.

Two runs with the same fingerprint make the same samples, so a run may resume in a folder only under its fingerprint.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from simulator.io.files import sha256_file
from simulator.io.json import canonical_json, plain

PACKAGES = (
    "flatlight", "numpy", "scipy", "scikit-image", "array-api-compat", "mitsuba", "drjit", "OpenEXR", "colour-science",
    "pillow", "tifffile", "trimesh",
)  # fmt: skip
"""Packages whose version may change a sample's bytes."""
_OPENCV = ("opencv-python-headless", "opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless")
_FREE_IN_PSF = ("check",)  # how closely errors are looked at changes no value
# Where, how fast, how many, and what is let through: not what.
_FREE_IN_DATASET = ("output", "workers", "engine", "ray", "timeout_s", "train", "validation", "test", "share_videos")

_LISTED_INPUTS = 100  # more input files than this count as one: dataset.json stays readable


def package_versions() -> dict[str, str]:
    """Return the installed version of every package in ``PACKAGES``, ``absent`` where there is none."""
    return {name: version for package in PACKAGES for name, version in _versions_of(package).items()}


def installed_versions(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of packages here, ``absent`` for those that are not installed."""
    found: dict[str, str] = {}
    for name in names:
        found[name] = "absent"
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def cpu_level() -> str:
    """Return the processor kind and its best vector extension: NumPy's float32 functions differ between them."""
    shown: Any = np.show_config(mode="dicts")
    found = shown.get("SIMD Extensions", {}).get("found") or ["baseline"]
    return f"{platform.machine()} {found[-1]}"


def build_fingerprint(
    config: Mapping[str, Any], backend: str, input_files: Iterable[Path | str] = (), packages: Iterable[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Hash what decides the samples' bytes.

    Left out of the configuration: ``name`` and ``dataset.output``, ``workers``, ``engine``, ``ray``, ``timeout_s``,
    ``train``, ``validation``, ``test``, ``share_videos``, ``psf.check``. Input files count by name and content; their place
    counts where the configuration names it.

    Args:
        config: the configuration as a dict, as ``Config.model_dump()`` gives it.
        backend: the renderer's variant, for example ``llvm_ad_rgb``.
        input_files: files whose contents decide samples: imported frames, measured PSFs, plugins' own code.
        packages: further packages that this data set's scenes come through, by the names that pip knows; any of OpenCV's
            stands for whichever of them is installed.

    Returns:
        64 hexadecimal digits, and the parts that were hashed (plain JSON, kept in ``dataset.json``).

    Raises:
        InputError: an input file cannot be read, or a value of the configuration has no JSON form.
    """
    kept = deciding(config)
    paths = [Path(path) for path in input_files]
    inputs = {name: sha256_file(path) for name, path in zip(distinct_names(p.name for p in paths), paths, strict=True)}
    if len(inputs) > _LISTED_INPUTS:
        inputs = {f"{len(inputs)} files": hashlib.sha256(canonical_json(inputs)).hexdigest()}
    versions = package_versions()
    if isinstance(kept.get("render"), Mapping) and kept["render"].get("denoise"):
        versions["pyoidn"] = metadata.version("pyoidn")
    for name in packages:
        versions |= _versions_of(name)
    parts = plain({"backend": backend, "config": kept, "inputs": inputs, "versions": versions}, "configuration")
    return hash_parts(parts), parts


def hash_parts(parts: Mapping[str, Any]) -> str:
    """Return the fingerprint of its parts: 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(parts)).hexdigest()


def deciding(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration without what decides no sample's bytes."""
    kept = {key: value for key, value in config.items() if key != "name"}
    for section, free in (("dataset", _FREE_IN_DATASET), ("psf", _FREE_IN_PSF)):
        if isinstance(kept.get(section), Mapping):
            kept[section] = {key: value for key, value in kept[section].items() if key not in free}
    return kept


def distinct_names(names: Iterable[str]) -> Iterator[str]:
    """Yield each name, with ``#2``, ``#3`` and so on where it came before; in time proportional to the number of names.

    Example:
        >>> list(distinct_names(["a", "a", "b", "a"]))
        ['a', 'a#2', 'b', 'a#3']
    """
    taken: set[str] = set()
    last: dict[str, int] = {}
    for name in names:
        distinct, number = name, last.get(name, 1)
        while distinct in taken:  # more than once only where a file itself is called name#2
            number += 1
            distinct = f"{name}#{number}"
        last[name] = number
        taken.add(distinct)
        yield distinct


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


def _versions_of(name: str) -> dict[str, str]:
    """Return the version of a package; of OpenCV, which several packages install as ``cv2``, those of all that are there."""
    found: dict[str, str] = {}
    for candidate in _OPENCV if name in _OPENCV else (name,):
        with suppress(metadata.PackageNotFoundError):
            found[candidate] = metadata.version(candidate)
    return found or {name: "absent"}


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
