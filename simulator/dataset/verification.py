"""Checks a data set on disk against its own promises: hashes, readability, pairing, completeness.

Reads files only; code that the data set names is never imported.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath

from simulator.camera.shutter import Shutter
from simulator.dataset.dataset_info import DatasetInfo, check_fingerprint, check_shutter, read_info
from simulator.dataset.engines import run
from simulator.dataset.manifest import MANIFEST, SKIPPED, Entry, Manifest, load_manifest, load_skipped
from simulator.dataset.sample import (
    DESCRIPTION,
    SPLITS,
    StoredSample,
    digest_of,
    read_description,
    sample_folder,
    sample_index,
)
from simulator.errors import InputError
from simulator.io.files import leftovers, sha256_bytes
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack


@dataclass(frozen=True)
class Report:
    """What ``verify`` found.

    Attributes:
        problems: one line per fault, each naming its file or sample.
        counts: intact samples per split.
        wanted: samples per split that ``dataset.json`` asks for.
        skipped: samples per split that ``generate --skip-bad`` left out for good; none where a split is absent.
    """

    problems: tuple[str, ...]
    counts: dict[str, int]
    wanted: dict[str, int]
    skipped: dict[str, int] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether there is no problem at all."""
        return not self.problems

    def __str__(self) -> str:
        parts = [
            f"{split}: {self.counts[split]} of {wanted} intact"
            + (f", {self.skipped[split]} skipped ({SKIPPED})" if self.skipped.get(split) else "")
            for split, wanted in self.wanted.items()
        ]
        head = ", ".join(parts) if parts else "no splits"
        return "\n".join([head, *self.problems, "all is well" if self.ok else f"{len(self.problems)} problem(s)"])


def verify(path: Path | str, *, workers: int | str = 1, progress: Callable[[int, int], None] | None = None) -> Report:
    """Re-hash and re-read everything in a data set.

    Args:
        path: the data set's folder.
        workers: processes that check samples; 1 stays in this process.
        progress: called with (samples checked, samples in all) after each sample.

    Raises:
        InputError: no such folder. Every other fault is a line of the report.
    """
    root = Path(path)
    if not root.is_dir():
        raise InputError(root, "no such folder; give the folder that `flatlight generate` wrote (dataset.output)")
    problems: list[str] = []
    try:
        info = read_info(root)
    except InputError as error:
        return Report((str(error),), {}, {})
    try:
        manifest = load_manifest(root)
    except InputError as error:
        return Report((str(error),), dict.fromkeys(info.counts, 0), info.counts)
    skipped: Counter[str] = Counter()
    try:
        skipped.update(split for split, name in load_skipped(root) if (split, name) not in manifest.entries)
    except InputError as error:
        problems.append(str(error))
    problems += _check_lists(root, info, manifest, skipped)
    problems += check_fingerprint(info)
    shutter, faults = check_shutter(info)
    problems += faults
    fingerprint = ""
    try:
        fingerprint = read_psf_stack(root / PSF_FOLDER).fingerprint
    except InputError as error:
        problems.append(str(error))
    problems += _check_captured(root, info, fingerprint)
    counts = dict.fromkeys(info.counts, 0)
    engine = "inline" if workers == 1 else "local"
    check = partial(check_sample, root, info, shutter, fingerprint)
    entries = list(manifest.entries.values())
    for number, outcome in enumerate(run(engine, check, entries, workers=workers), start=1):
        entry = outcome.task
        found = [f"{entry.split}/{entry.id}: {outcome.error}"] if outcome.error else outcome.value or []
        problems += found
        counts[entry.split] = counts.get(entry.split, 0) + (not found)
        if progress is not None:
            progress(number, len(entries))
    return Report(tuple(problems), counts, info.counts, dict(skipped))


def check_sample(
    root: Path, info: DatasetInfo, shutter: Shutter | None, psf_fingerprint: str, entry: Entry
) -> list[str]:
    """Check one sample against its manifest line; return its faults, none when it is intact."""
    folder = sample_folder(root, entry.split, sample_index(entry.id))
    where = f"{entry.split}/{entry.id}"
    if not folder.is_dir():
        return [f"{where}: in {MANIFEST} but not on disk; run generate again after deleting its line"]
    try:
        description, data = read_description(folder)
    except InputError as error:
        return [f"{where}: {error}"]
    problems = [f"{where}: unexpected file {name}" for name in _unexpected(folder, description["files"])]
    files: dict[str, bytes] = {}
    hashes = {DESCRIPTION: sha256_bytes(data)}
    for name, expected in description["files"].items():
        try:
            files[name] = (folder / name).read_bytes()
        except OSError as error:
            problems.append(f"{where}: {name} cannot be read: {error.strerror or error}")
            continue
        hashes[name] = sha256_bytes(files[name])
        if hashes[name] != expected:
            problems.append(f"{where}: {name} has other content than {DESCRIPTION} says (SHA-256 differs)")
    if len(files) < len(description["files"]):
        return problems
    if digest_of(hashes) != entry.digest:
        problems.append(f"{where}: its digest differs from the one in {MANIFEST}")
    identity = (description["id"], description["split"], description["seed"], description["label"])
    if identity != (entry.id, entry.split, entry.seed, entry.label):
        problems.append(f"{where}: {DESCRIPTION} speaks of another sample: {identity}")
    try:
        sample = StoredSample(folder, description, files).sample()
    except InputError as error:
        return [*problems, f"{where}: {error}"]
    sizes = {
        "measurement": (sample.measurement.shape[1:], info.sensor_shape),
        "ground truth": (sample.rgb.shape[1:3], info.scene_shape),
        "channels": (sample.channels, info.channels),
    }
    for name, (found, promised) in sizes.items():
        if found != promised:
            problems.append(f"{where}: {name} is {found}, dataset.json says {promised}")
    if shutter is not None and sample.frame_edges_s is not None:
        try:
            shutter.weights(info.sensor_shape[0], sample.frame_edges_s)
        except InputError as error:
            problems.append(f"{where}: its frames do not cover the shutter: {error.reason.split(';')[0]}")
    made_with = {"full_scale": info.exposure.get("full_scale"), "psf": psf_fingerprint or None}
    for name, promised in made_with.items():
        found = sample.metadata.get(name, promised)
        if promised is not None and found != promised:
            problems.append(f"{where}: it was made with {name} = {found}, the data set says {promised}")
    return problems


def _unexpected(folder: Path, files: Iterable[str]) -> list[str]:
    """Return what lies in a sample's folder beside its files; of a folder that should not be there its name only."""
    wanted = {DESCRIPTION, *files}
    folders = {PurePosixPath(name).parent for name in wanted}
    found = sorted(PurePosixPath(path.relative_to(folder).as_posix()) for path in folder.rglob("*"))
    return [str(path) for path in found if path.parent in folders and path not in folders and str(path) not in wanted]


def _check_captured(root: Path, info: DatasetInfo, psf_fingerprint: str) -> list[str]:
    """Check the stack as captured, where the configuration asked for one."""
    if not info.config.get("psf", {}).get("as_captured"):
        return []
    try:
        nominal = read_psf_stack(root / CAPTURED_FOLDER).provenance.get("nominal_fingerprint")
    except InputError as error:
        return [str(error)]
    if psf_fingerprint and nominal != psf_fingerprint:
        return [f"{CAPTURED_FOLDER}: captured from psf = {nominal}, the data set says {psf_fingerprint}"]
    return []


def _check_lists(root: Path, info: DatasetInfo, manifest: Manifest, skipped: Mapping[str, int]) -> list[str]:
    problems = []
    if manifest.torn:
        problems.append(f"{MANIFEST}: the last line is torn; the next generate cuts it and makes that sample again")
    for split, wanted in info.counts.items():
        found, left_out = len(manifest.ids(split)), skipped.get(split, 0)
        if found + left_out < wanted:
            more = f" and {left_out} skipped" if left_out else ""
            problems.append(f"{split}: {found} of {wanted} samples are finished{more}; run generate again to resume")
        elif found > wanted:
            problems.append(f"{split}: {found} samples in {MANIFEST}, dataset.json says {wanted}")
    for split in sorted({split for split, _ in manifest.entries} - set(info.counts)):
        problems.append(f"{split}: {len(manifest.ids(split))} samples in {MANIFEST}, dataset.json has no such split")
    known = {sample_folder(root, split, sample_index(name)) for split, name in manifest.entries}
    for folder in _sample_folders(root):
        if folder not in known:
            problems.append(
                f"{folder.relative_to(root)}: on disk but not in {MANIFEST}; run generate again or delete it"
            )
    problems += [f"{path.relative_to(root)}: left by a run that died; delete it" for path in sorted(leftovers(root))]
    return problems


def _sample_folders(root: Path) -> Iterator[Path]:
    for split in SPLITS:
        for parent in sorted(root.glob(f"{split}/[0-9]*")):
            with os.scandir(parent) as entries:
                yield from sorted(Path(entry.path) for entry in entries if not entry.name.startswith("."))
