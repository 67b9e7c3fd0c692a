"""Checks a data set on disk against its own promises: hashes, readability, pairing, completeness, no stray files.

Reads files only; code that the data set names is never imported.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from simulator.camera.shutter import Shutter
from simulator.dataset.checksums import (
    CARD,
    CHECKSUMS,
    changed_files,
    files_to_seal,
    is_replaced_card,
    read_seal,
    write_seal,
)
from simulator.dataset.dataset_info import FILE, DatasetInfo, check_fingerprint, check_shutter, read_info
from simulator.dataset.engines import run
from simulator.dataset.manifest import (
    MANIFEST,
    SKIPPED,
    WRITERS,
    Entry,
    Key,
    Manifest,
    ManifestWriter,
    load_manifest,
    load_skipped,
)
from simulator.dataset.sample import (
    DESCRIPTION,
    SPLITS,
    Sample,
    StoredSample,
    digest_of,
    read_description,
    sample_folder,
    sample_index,
    stored_folder,
)
from simulator.errors import InputError
from simulator.io.exr import MAX_FILE_BYTES
from simulator.io.files import TEMPORARY_PREFIX, UnreadableError, not_plain, read_errors, read_limited, sha256_bytes
from simulator.io.store import Place, place, relative_name
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack


@dataclass(frozen=True)
class Report:
    """What ``verify`` found.

    Attributes:
        problems: one line per fault, each naming its file or sample.
        counts: intact samples per split.
        wanted: samples per split that ``dataset.json`` asks for.
        skipped: samples per split that ``generate --skip-bad`` left out for good; none where a split is absent.
        notes: one line per file that may lie there, but was not checked.
        bad: the samples whose own files are damaged or gone.
        unread: the samples that could not be judged: the disk or the network failed, or a worker died of them.
        crowded: the samples that have other files in their folders.
    """

    problems: tuple[str, ...]
    counts: dict[str, int]
    wanted: dict[str, int]
    skipped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    bad: frozenset[Key] = frozenset()
    unread: frozenset[Key] = frozenset()
    crowded: frozenset[Key] = frozenset()

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
        end = "all is well" if self.ok else f"{len(self.problems)} problem(s)"
        return "\n".join([head, *self.problems, *(f"note: {line}" for line in self.notes), end])


def verify(
    path: Place | str,
    *,
    workers: int | str = 1,
    seal: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Report:
    """Re-hash and re-read everything in a data set.

    Args:
        path: the data set's folder.
        workers: processes that check samples; 1 stays in this process.
        seal: write ``checksums.json`` where that is all that is missing, as in data sets of versions that wrote none.
        progress: called with (samples checked, samples in all) after each sample.

    Raises:
        InputError: no such folder, or, to seal it, one that a job is writing to. Every other fault is a line of the report.
        StorageError: the seal cannot be written.
    """
    root = place(path)
    if not root.is_dir():
        raise InputError(root, "no such folder; give the folder that `flatlight generate` wrote (dataset.output)")
    if outside := check_plain(root):
        return Report(tuple(outside), {}, {})
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
    hashes, faults = check_seal(root)
    sealed, faulty = hashes is not None, {error.path for error in faults}
    problems += [str(error) for error in faults]
    problems += check_lists(info, manifest, skipped)
    strays, notes = _check_places(root, manifest, hashes)
    problems += strays
    problems += check_fingerprint(info)
    shutter, lines = check_shutter(info)
    problems += lines
    fingerprint = ""
    try:
        fingerprint = read_psf_stack(root / PSF_FOLDER).fingerprint
    except InputError as error:
        problems += [str(error)] if error.path not in faulty else []
    problems += _check_captured(root, info, fingerprint, faulty)
    counts = dict.fromkeys(info.counts, 0)
    engine = "inline" if workers == 1 else "local"
    check = partial(_judged, root, info, shutter, fingerprint)
    entries, bad, unread, crowded = list(manifest.entries.values()), set[Key](), set[Key](), set[Key]()
    for number, outcome in enumerate(run(engine, check, entries, workers=workers), start=1):
        entry, key = outcome.task, (outcome.task.split, outcome.task.id)
        sample = outcome.value or CheckedSample((f"{entry.split}/{entry.id}: {outcome.error}",), unread=True)
        problems += sample.problems
        for fits, kind in ((sample.damaged, bad), (sample.unread, unread), (sample.strays > 0, crowded)):
            if fits:
                kind.add(key)
        counts[entry.split] = counts.get(entry.split, 0) + (not sample.problems)
        if progress is not None:
            progress(number, len(entries))
    if not sealed and not problems and seal:
        with ManifestWriter(root):  # its lock: no job is writing
            write_seal(root)
    elif not sealed:
        problems.insert(0, UNSEALED)
    return Report(tuple(problems), counts, info.counts, dict(skipped), notes, *map(frozenset, (bad, unread, crowded)))


UNSEALED = (
    f"{CHECKSUMS}: missing, so nothing shows that {FILE} and {PSF_FOLDER} are as they were written. Either the run has not "
    "come to its end: the same `flatlight generate` finishes and seals it. Or the version that made it wrote none: where you "
    "know the data set to be whole, `flatlight verify --seal` writes it"
)


def check_plain(root: Place) -> list[str]:
    """Return a line for everything in a data set through which something outside would be read, or waited for."""
    return [
        f"{relative_name(path, root)}: {'a link' if path.is_symlink() else 'not a file'}; nothing of the data set "
        "was read: its files lie in its own folder. Put a copy of the file there (cp -rL follows links), or remove it"
        for path in not_plain(root)
    ]


def check_seal(root: Place) -> tuple[dict[str, str] | None, list[InputError]]:
    """Return the sealed hashes, None where there is no seal, and what is not as it was sealed."""
    try:
        hashes = read_seal(root)
    except InputError as error:
        return {}, [error]
    if hashes and CARD in hashes and is_replaced_card(root / CARD):
        del hashes[CARD]  # the user's by now
    return hashes, list(changed_files(root, hashes or {}))


@dataclass(frozen=True)
class CheckedSample:
    """A sample as it was read, once, and what is wrong with it.

    Attributes:
        problems: one line per fault, none when it is intact.
        description: the content of ``sample.json``; empty where it cannot be read.
        files: the bytes of its files by name, ``sample.json`` included.
        sample: what they hold; None where that cannot be read.
        strays: how many of the faults are files that are not the sample's.
        unread: whether a file is there, but could not be read just now.
    """

    problems: tuple[str, ...]
    description: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    sample: Sample | None = None
    strays: int = 0
    unread: bool = False

    @property
    def damaged(self) -> bool:
        """Whether the sample's own files are not as they were written."""
        return not self.unread and len(self.problems) > self.strays


def _judged(root: Place, info: DatasetInfo, shutter: Shutter | None, fingerprint: str, entry: Entry) -> CheckedSample:
    """Check one sample; what it holds stays in the process that read it."""
    return replace(checked_sample(root, info, shutter, fingerprint, entry), description={}, files={}, sample=None)


def check_sample(
    root: Place, info: DatasetInfo, shutter: Shutter | None, psf_fingerprint: str, entry: Entry
) -> list[str]:
    """Check one sample against its manifest line; return its faults, none when it is intact."""
    return list(checked_sample(root, info, shutter, psf_fingerprint, entry).problems)


def checked_description(root: Place, entry: Entry) -> CheckedSample:
    """Read a sample's ``sample.json`` only, and hold it and the hashes that it lists against the sample's manifest line."""
    where = f"{entry.split}/{entry.id}"
    try:
        folder = stored_folder(root, entry.split, entry.id)
        if not folder.is_dir():
            return CheckedSample(
                (f"{where}: in {MANIFEST} but not on disk; run generate again after deleting its line",)
            )
        description, data = read_description(folder)
    except InputError as error:
        return CheckedSample((f"{where}: {error}",), unread=isinstance(error, UnreadableError))
    problems = []
    if digest_of(description["files"] | {DESCRIPTION: sha256_bytes(data)}) != entry.digest:
        problems.append(f"{where}: its digest differs from the one in {MANIFEST}")
    identity = (description["id"], description["split"], description["seed"], description["label"])
    if identity != (entry.id, entry.split, entry.seed, entry.label):
        problems.append(f"{where}: {DESCRIPTION} speaks of another sample: {identity}")
    return CheckedSample(tuple(problems), description, {DESCRIPTION: data})


def checked_sample(
    root: Place, info: DatasetInfo, shutter: Shutter | None, psf_fingerprint: str, entry: Entry
) -> CheckedSample:
    """Read one sample, every file once, and check it against its manifest line and the data set."""
    described = checked_description(root, entry)
    description, files = described.description, dict(described.files)
    if not description:
        return described
    folder = sample_folder(root, entry.split, sample_index(entry.id))
    where = f"{entry.split}/{entry.id}"
    problems = [f"{where}: unexpected file {name}" for name in _unexpected(folder, description["files"])]
    strays, unread = len(problems), False
    for name, expected in description["files"].items():
        try:
            files[name] = read_limited(folder / name, "an OpenEXR file", MAX_FILE_BYTES)
        except InputError as error:
            problems.append(f"{where}: {name} {error.reason}")
            unread |= isinstance(error, UnreadableError)
            continue
        if sha256_bytes(files[name]) != expected:
            problems.append(f"{where}: {name} has other content than {DESCRIPTION} says (SHA-256 differs)")
    problems += described.problems
    if len(files) <= len(description["files"]):
        return CheckedSample(tuple(problems), description, files, strays=strays, unread=unread)
    try:
        sample = StoredSample(folder, description, files).sample()
    except InputError as error:
        return CheckedSample((*problems, f"{where}: {error}"), description, files, strays=strays)
    problems += [f"{where}: {line}" for line in _not_as_promised(sample, info, shutter, psf_fingerprint)]
    return CheckedSample(tuple(problems), description, files, sample, strays)


def _not_as_promised(sample: Sample, info: DatasetInfo, shutter: Shutter | None, psf_fingerprint: str) -> Iterator[str]:
    """Yield a line for everything in which a sample is not what the data set promises of all."""
    sizes = {
        "measurement": (sample.measurement.shape[1:], info.sensor_shape),
        "ground truth": (sample.rgb.shape[1:3], info.scene_shape),
        "channels": (sample.channels, info.channels),
    }
    for name, (found, promised) in sizes.items():
        if found != promised:
            yield f"{name} is {found}, dataset.json says {promised}"
    if shutter is not None and sample.frame_edges_s is not None:
        try:
            shutter.weights(info.sensor_shape[0], sample.frame_edges_s)
        except InputError as error:
            yield f"its frames do not cover the shutter: {error.reason.split(';')[0]}"
    made_with = {"full_scale": info.exposure.get("full_scale"), "psf": psf_fingerprint or None}
    for name, promised in made_with.items():
        found = sample.metadata.get(name, promised)
        if promised is not None and found != promised:
            yield f"it was made with {name} = {found}, the data set says {promised}"


def _unexpected(folder: Place, files: Iterable[str]) -> list[str]:
    """Return what lies in a sample's folder beside its files; of a folder that should not be there its name only."""
    wanted = {DESCRIPTION, *files}
    folders = {PurePosixPath(name).parent for name in wanted}
    found = sorted(PurePosixPath(relative_name(path, folder)) for path in folder.rglob("*"))
    return [str(path) for path in found if path.parent in folders and path not in folders and str(path) not in wanted]


def _check_captured(root: Place, info: DatasetInfo, psf_fingerprint: str, faulty: Container[str]) -> list[str]:
    """Check the stack as captured, where the configuration asked for one; of ``faulty`` files a problem is told already."""
    if not info.config.get("psf", {}).get("as_captured"):
        return []
    try:
        nominal = read_psf_stack(root / CAPTURED_FOLDER).provenance.get("nominal_fingerprint")
    except InputError as error:
        return [str(error)] if error.path not in faulty else []
    if psf_fingerprint and nominal != psf_fingerprint:
        return [f"{CAPTURED_FOLDER}: captured from psf = {nominal}, the data set says {psf_fingerprint}"]
    return []


def check_lists(info: DatasetInfo, manifest: Manifest, skipped: Mapping[str, int]) -> list[str]:
    """Return a line for each way in which the lists of finished and skipped samples are not what ``dataset.json`` wants."""
    problems = []
    if manifest.torn:
        problems.append(f"{MANIFEST}: the last line is torn; the next generate cuts it and makes that sample again")
    if manifest.duplicates:
        problems.append(
            f"{MANIFEST}: {manifest.duplicates} lines too many, of samples that a later line names again; the next generate "
            "keeps the last line of each"
        )
    for split, wanted in info.counts.items():
        found, left_out = len(manifest.ids(split)), skipped.get(split, 0)
        if found + left_out < wanted:
            more = f" and {left_out} skipped" if left_out else ""
            problems.append(f"{split}: {found} of {wanted} samples are finished{more}; run generate again to resume")
        elif found > wanted:
            problems.append(f"{split}: {found} samples in {MANIFEST}, dataset.json says {wanted}")
    for split in sorted({split for split, _ in manifest.entries} - set(info.counts)):
        problems.append(f"{split}: {len(manifest.ids(split))} samples in {MANIFEST}, dataset.json has no such split")
    return problems


_THOUSAND = r"(\d{4}|[1-9]\d{4})"
_SPLIT_FOLDER = re.compile(rf"({'|'.join(SPLITS)})(/{_THOUSAND})?")
_SAMPLE_FOLDER = re.compile(rf"({'|'.join(SPLITS)})/{_THOUSAND}/s\d{{8}}")
_YOURS = re.compile(r"(README|LICEN[CS]E|CITATION|CHANGELOG)(\.(md|txt|rst|cff|bib))?")
"""What people lay beside data that they pass on."""


def _check_places(
    root: Place, manifest: Manifest, hashes: Mapping[str, str] | None
) -> tuple[list[str], tuple[str, ...]]:
    """Name what lies anywhere in a data set, outside its samples' folders, and should not; and what may, unchecked.

    Of a folder that should not be there only its name is told.
    """
    problems, notes = [], []
    files = {CHECKSUMS, *(hashes or files_to_seal(root))}
    folders = {PSF_FOLDER, *(str(PurePosixPath(name).parent) for name in files)}
    samples = {str(sample_folder(Path(), split, sample_index(name))) for split, name in manifest.entries}
    pending = [root]
    while pending:
        folder = pending.pop()
        try:
            with read_errors(folder):
                paths = sorted(folder.iterdir())
        except InputError as error:
            problems.append(str(error))
            continue
        for path in paths:
            name = relative_name(path, root)
            if name in files or name in samples:
                continue
            if (name in folders or _SPLIT_FOLDER.fullmatch(name)) and path.is_dir():
                pending.append(path)
            elif name == WRITERS:
                problems.append(f"{name}: lists of runs that are at work or died; the next generate merges them")
            elif path.name.startswith(TEMPORARY_PREFIX):
                problems.append(f"{name}: left by a run that died; delete it")
            elif _SAMPLE_FOLDER.fullmatch(name):
                problems.append(f"{name}: on disk but not in {MANIFEST}; run generate again or delete it")
            elif _YOURS.fullmatch(name):
                notes.append(f"{name}: not of the data set, so not checked")
            else:
                problems.append(f"{name}: a stray {'folder' if path.is_dir() else 'file'}; move it out of the data set")
    return problems, tuple(notes)
