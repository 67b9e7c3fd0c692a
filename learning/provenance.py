"""Which job a folder belongs to, what made a result, and which scenes it has seen."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from simulator import __version__
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json
from simulator.validation import renamed


def read_description(path: Path, kind: str) -> dict[str, Any]:
    """Return what a job wrote about its folder, with today's keys."""
    cure = "restore it from a copy, or choose another output folder"
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({error}); {cure}") from error
    if not isinstance(content, dict):
        raise InputError(path, f"not a description of a {kind}; {cure}")
    return renamed(content)


def sample_digests(dataset: Dataset) -> list[str]:
    """Return the digest of each sample of a split, by which samples that were made again are told apart."""
    entries = load_manifest(dataset.root).entries
    return [entries[dataset.split, sample].digest for sample in dataset.ids]


def scenes_of(dataset: Dataset) -> list[str]:
    """Return what the scenes of a split are known by, whatever camera saw them: splits with a name in common show the same.

    Scenes that a family draws follow from the root seed, the split and the index: the same numbers draw the same things,
    through any mask, sensor and PSF, in any size, at any depth, more finely rendered or with other parameters. So the family
    has one name per seed and split, in words. Imported scenes are known by their recordings, of which there are many: a hash
    for each video or sequence, wherever it lies; of a source that names neither, for all that it says of a clip. Scenes of a
    data set, seen again, are known by what they were known by there.
    """
    scene, seed, split = dataset.config["scene"], dataset.config["seed"], dataset.split
    if scene.get("family") is not None:
        return [_known_by(scene, {}, seed, split)]
    said = (dataset.stored(position).description["metadata"]["scene"] for position in range(len(dataset)))
    return sorted({_known_by(scene, clip, seed, split) for clip in said})


def clips_of(dataset: Dataset) -> tuple[str, ...]:
    """Return what each clip of a split is known by, whatever camera saw it: its data set, and its name there.

    Samples of a data set that were seen again, once or oftener, are known by that data set and their names in it, also
    backwards.
    """
    found = []
    for place, name in enumerate(dataset.ids):
        own = {"data set": dataset.fingerprint, "sample": f"{dataset.split}/{name}"}
        first = [own, *_seen_again(dataset, place)][-1]
        found.append(f"{first['data set']} {first['sample']}")
    return tuple(found)


def playback(dataset: Dataset) -> Literal["forwards", "backwards", "still"]:
    """Return how the clips of a split run, compared with those that were first rendered or imported."""
    views = list(_seen_again(dataset, 0)) if len(dataset) else []
    if any(view.get("still") for view in views):
        return "still"
    return "backwards" if sum(bool(view.get("backwards")) for view in views) % 2 else "forwards"


def _seen_again(dataset: Dataset, position: int) -> Iterator[Mapping[str, Any]]:
    """Yield what the source `samples` says of a sample, then what it said of the one that this was made from, and so on."""
    made_by = dataset.config["scene"]
    if made_by.get("source") != "samples":
        return
    clip = dataset.stored(position).description["metadata"]["scene"]
    while made_by.get("source") == "samples":
        yield clip
        made_by, clip = clip["made by"], clip["scene"]


def _known_by(made_by: Mapping[str, Any], clip: Mapping[str, Any], seed: int, split: str) -> str:
    """Return what a scene of a family or a source is known by; ``clip`` is what the source says of it."""
    if made_by.get("family") is not None:
        return f"{PurePosixPath(made_by['family']).name}, seed {seed}, {split}"
    if made_by["source"] == "samples":
        return _known_by(clip["made by"], clip["scene"], clip["seed"], clip["sample"].partition("/")[0])
    return sha256_bytes(canonical_json([PurePosixPath(made_by["source"]).name, _recording(clip)]))[:16]


def _recording(scene: Mapping[str, Any]) -> Any:
    """Return what an imported clip is a part of: its video, its sequence, or the folder of its images."""
    for key in ("video", "sequence"):
        if key in scene:
            return scene[key]
    return PurePosixPath(scene["picture"]).parent.as_posix() if "picture" in scene else scene


def versions(*packages: str) -> dict[str, str]:
    """Return the versions of Flatlight, Python and packages; "absent" for those that are not installed."""
    found = {"flatlight": __version__, "python": platform.python_version()}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found
