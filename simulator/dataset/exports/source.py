"""What an export reads: the finished samples of a data set, each checked as ``verify`` checks it, before it is passed on."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.dataset_info import FILE, DatasetInfo, check_shutter, read_info
from simulator.dataset.manifest import Entry, load_manifest, load_skipped
from simulator.dataset.sample import DESCRIPTION, SPLITS, Sample, sample_folder, sample_index
from simulator.dataset.verification import (
    UNSEALED,
    CheckedSample,
    check_lists,
    check_plain,
    check_seal,
    checked_description,
    checked_sample,
)
from simulator.errors import InputError
from simulator.io.files import read_errors, sha256_bytes
from simulator.io.store import Place, size_of
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack, stack_files

_EXTRA = re.compile(r"[^\W_][\w-]*")  # of an extra that becomes part of a path in another file


@dataclass(frozen=True)
class Source:
    """A data set whose samples are exported.

    Attributes:
        root: its folder.
        info: the content of ``dataset.json``.
        splits: the manifest's lines by split, in the order of ids; only the splits that were asked for.
        companions: SHA-256 by name of what belongs to all samples: ``dataset.json`` and the files of its stacks; None where
            no seal says it.
    """

    root: Place
    info: DatasetInfo
    splits: dict[str, tuple[Entry, ...]]
    companions: dict[str, str | None]
    check: Callable[[Entry], CheckedSample]

    @property
    def samples(self) -> int:
        """How many samples there are in all splits."""
        return sum(map(len, self.splits.values()))

    @property
    def digest(self) -> str:
        """SHA-256 over the splits, ids and digests of all samples: of what an export holds."""
        lines = (f"{one.split}/{one.id} {one.digest}\n" for entries in self.splits.values() for one in entries)
        return sha256_bytes("".join(lines).encode())

    def folder(self, entry: Entry) -> Place:
        """Return the folder of a sample."""
        return sample_folder(self.root, entry.split, sample_index(entry.id))

    def read(self, entry: Entry) -> CheckedSample:
        """Return a whole sample, read once.

        Raises:
            InputError: it is damaged.
        """
        return self._intact(self.check(entry))

    def describe(self, entry: Entry) -> tuple[CheckedSample, dict[str, int]]:
        """Return a sample of which only ``sample.json`` was read, and how many bytes each of its files has.

        Raises:
            InputError: ``sample.json`` is damaged, or a file is gone.
        """
        found, folder = self._intact(checked_description(self.root, entry)), self.folder(entry)
        sizes = {DESCRIPTION: len(found.files[DESCRIPTION])}
        for name in found.description["files"]:
            with read_errors(folder / name):
                sizes[name] = size_of(folder / name)
        return found, sizes

    def _intact(self, sample: CheckedSample) -> CheckedSample:
        if sample.problems:
            raise InputError(
                self.root,
                f"{sample.problems[0]}; restore it from a copy, or let `flatlight generate FILE --repair` make it anew "
                f"(`flatlight verify {self.root}` lists all faults)",
            )
        return sample


def open_source(root: Place, splits: Sequence[str] = (), *, partial_too: bool = False) -> Source:
    """Open a data set for an export.

    Args:
        root: its folder.
        splits: which splits; all that it has by default.
        partial_too: take what is finished of a data set that is not.

    Raises:
        InputError: not a data set, one with links, one that is not as it was sealed or not finished, an unknown split, or
            no sample at all.
    """
    for line in check_plain(root) if root.is_dir() else ():
        raise InputError(root, line)
    info = read_info(root)
    unknown = [split for split in splits if split not in info.counts]
    if unknown:
        raise InputError("--split", f"got {unknown[0]!r}, expected one of {', '.join(info.counts)}, which {root} has")
    manifest = load_manifest(root)  # before its hash: what is not a list is found at its first line, whatever its size
    hashes, faults = check_seal(root)
    for error in faults:
        raise error
    skipped = Counter(split for split, name in load_skipped(root) if (split, name) not in manifest.entries)
    faulty = check_lists(info, manifest, skipped) + [UNSEALED] * (hashes is None)
    if faulty and not partial_too:
        raise InputError(root, f"not finished: {faulty[0]}. To export what there is: --partial")
    shutter, lines = check_shutter(info)
    for line in lines:
        raise InputError(root, line)
    fingerprint = read_psf_stack(root / PSF_FOLDER).fingerprint
    stacks = [root / name for name in (PSF_FOLDER, CAPTURED_FOLDER) if (root / name).exists()]
    companions = [FILE, *(f"{folder.name}/{name}" for folder in stacks for name in stack_files(folder))]
    wanted = [split for split in SPLITS if split in (splits or info.counts)]
    source = Source(
        root,
        info,
        {
            split: entries
            for split in wanted
            if (entries := tuple(one for one in manifest.entries.values() if one.split == split))
        },
        {name: (hashes or {}).get(name) for name in companions},
        partial(checked_sample, root, info, shutter, fingerprint),
    )
    if not source.samples:
        raise InputError(root, f"has no finished sample in {', '.join(wanted) or 'any split'}; nothing to export")
    return source


def arrays(sample: Sample) -> dict[str, NDArray[Any]]:
    """Return the arrays of a sample by name: those of its mapping, ``extras/NAME``, ``surroundings/rgb`` and ``/depth_m``.

    Raises:
        InputError: an extra's name that could not be part of a path.
    """
    found = {name: value for name, value in sample.items() if isinstance(value, np.ndarray)}
    for name, values in sample.extras.items():
        if not _EXTRA.fullmatch(name):
            raise InputError(f"extras[{name!r}]", "its name is part of a path here: expected letters, digits, _ and -")
        found[f"extras/{name}"] = values
    if (around := sample.surroundings) is not None:
        found |= {"surroundings/rgb": around.rgb, "surroundings/depth_m": around.depth_m}
    return found
