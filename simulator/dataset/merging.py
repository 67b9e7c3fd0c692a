"""Makes one data set of parts that were made apart, such as shards on the disks of their nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from simulator.dataset.beginning import is_begun
from simulator.dataset.checksums import unseal
from simulator.dataset.completion import complete
from simulator.dataset.dataset_info import DatasetInfo, check_shutter, read_info, write_info
from simulator.dataset.fingerprint import difference
from simulator.dataset.manifest import (
    Entry,
    Key,
    ManifestWriter,
    SkippedWriter,
    load_manifest,
    load_skipped,
)
from simulator.dataset.sample import (
    DESCRIPTION,
    SPLITS,
    SampleRecord,
    read_description,
    sample_folder,
    sample_index,
    stored_folder,
)
from simulator.dataset.shards import alone, remove_unfinished, sharing
from simulator.dataset.verification import check_sample
from simulator.errors import InputError
from simulator.io.exr import MAX_FILE_BYTES
from simulator.io.files import committed_folder, make_folder, read_limited, storage_errors, write_atomic
from simulator.io.store import Place, place
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack, write_psf_stack


@dataclass(frozen=True)
class MergeResult:
    """What ``merge`` did.

    Attributes:
        path: the data set.
        taken: samples copied into it.
        there: samples that it had already.
        problems: one line per sample that is damaged, or other than the one of its name that was there; none was taken.
        missing: samples that no part had.
    """

    path: Place
    taken: int
    there: int
    problems: tuple[str, ...]
    missing: int


def merge(
    target: Place | str,
    parts: Sequence[Place | str],
    *,
    progress: Callable[[int, int], None] | None = None,
    finish: Callable[[Place], object] | None = None,
) -> MergeResult:
    """Copy the samples of data sets of one fingerprint into one of them, or into a new one; the parts stay as they are.

    Args:
        target: the data set, made where there is none.
        parts: data sets, finished or not.
        progress: called with (samples looked at, samples in all).
        finish: called with the data set before it is sealed.

    Raises:
        InputError: a part is not a data set, or one of another fingerprint, exposure or PSF; or others write to the target.
        StorageError: the target cannot be written to.
    """
    root, folders = place(target), [place(part) for part in parts]
    if not folders:
        raise InputError("parts", "got none, expected the folders of data sets to take samples from")
    begun = is_begun(root, "output")
    infos = {folder: read_info(folder) for folder in [*([root] if begun else []), *folders]}
    merged = _common(infos)
    if isinstance(root, Path):
        with storage_errors(root):
            make_folder(root)
    with _sole(root) as manifest:
        unseal(root)
        remove_unfinished(manifest)
        for name in (PSF_FOLDER, CAPTURED_FOLDER):
            if (folders[0] / name).exists() and not (begun and (root / name).exists()):
                write_psf_stack(root / name, read_psf_stack(folders[0] / name))
        write_info(root, merged)
    with sharing(root, None, lambda _: None) as manifest:
        assert manifest is not None  # the description was just written
        result = _take_samples(root, infos, merged, manifest, progress or (lambda done, total: None))
    with _sole(root) as manifest:
        complete(manifest, finish if result.taken + result.there else None)
    return result


@contextmanager
def _sole(root: Place) -> Iterator[ManifestWriter]:
    with alone(root) as manifest:
        if manifest is None:
            raise InputError(root, "another process is writing to it; wait for its end, and run merge again")
        yield manifest


def _common(infos: dict[Place, DatasetInfo]) -> DatasetInfo:
    """Return the description of what the parts make together: the most samples that one of them asks for.

    Raises:
        InputError: they are not of one data set.
    """
    (first_folder, first), *others = infos.items()
    for folder, info in others:
        if info.fingerprint != first.fingerprint:
            changes = difference(first.fingerprint_parts, info.fingerprint_parts)
            raise InputError(folder, f"of another data set than {first_folder}; they differ in:\n{changes}")
        if info.exposure.get("full_scale") != first.exposure.get("full_scale"):
            raise InputError(
                folder, f"made with another exposure than {first_folder} (dataset.json: exposure.full_scale)"
            )
    stacks = {folder: read_psf_stack(folder / PSF_FOLDER).fingerprint for folder in infos}
    for folder, fingerprint in stacks.items():
        if fingerprint != stacks[first_folder]:
            raise InputError(folder / PSF_FOLDER, f"another stack than that of {first_folder}")
    return replace(first, counts={split: max(info.counts.get(split, 0) for info in infos.values()) for split in SPLITS})


def _take_samples(
    root: Place,
    infos: Mapping[Place, DatasetInfo],
    info: DatasetInfo,
    manifest: ManifestWriter,
    progress: Callable[[int, int], None],
) -> MergeResult:
    shutter, _ = check_shutter(info)
    fingerprint = read_psf_stack(root / PSF_FOLDER).fingerprint
    lists = {folder: load_manifest(folder).entries for folder in infos if folder != root}
    there = load_manifest(root).entries
    total, looked_at, taken, problems = sum(map(len, lists.values())), 0, 0, []
    digests: dict[Key, str] = {key: entry.digest for key, entry in there.items()}
    for folder, entries in lists.items():
        for key, entry in entries.items():
            if key not in digests:
                faults = check_sample(folder, info, shutter, fingerprint, entry)
                problems += [f"{folder}: {fault}" for fault in faults]
                if not faults:
                    _copy(folder, root, entry)
                    record = SampleRecord(entry.id, entry.split, entry.digest, entry.seed, entry.label)
                    cpu = entry.cpu or infos[folder].versions.get("cpu")
                    manifest.append(
                        record, entry.seconds, entry.stages, None if cpu == info.versions.get("cpu") else cpu
                    )
                    digests[key] = entry.digest
                    taken += 1
            elif digests[key] != entry.digest:
                problems.append(f"{folder}: {'/'.join(key)}: another one than the sample of this name that is there")
            looked_at += 1
            progress(looked_at, total)
    skipped = {key: reason for folder in lists for key, reason in load_skipped(folder).items() if key not in digests}
    known = load_skipped(root)
    for (split, name), reason in skipped.items():
        if (split, name) not in known:
            with SkippedWriter(manifest.folder) as skipping:
                skipping.append(split, sample_index(name), reason)
    missing = sum(info.counts.values()) - len(digests.keys() | skipped.keys() | known.keys())
    return MergeResult(root, taken, len(there), tuple(problems), max(0, missing))


def _copy(folder: Place, root: Place, entry: Entry) -> None:
    """Copy a sample whose files were checked."""
    own = stored_folder(folder, entry.split, entry.id)
    names = [DESCRIPTION, *read_description(own)[0]["files"]]
    with committed_folder(sample_folder(root, entry.split, sample_index(entry.id)), DESCRIPTION) as made:
        for name in names:
            data = read_limited(own / name, "a file of a sample", MAX_FILE_BYTES)
            (made / name).parent.mkdir(exist_ok=True)
            write_atomic(made / name, data)
