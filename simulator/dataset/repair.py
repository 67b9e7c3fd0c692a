"""Takes out of a data set what is damaged, so that the next run makes exactly that anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from simulator.dataset.checksums import CHECKSUMS, changed_files, read_seal
from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import ManifestWriter, load_manifest, merge_lists, rewrite_manifest
from simulator.dataset.sample import sample_folder, sample_index
from simulator.dataset.verification import verify
from simulator.errors import InputError
from simulator.io.files import remove_file, remove_folder
from simulator.io.store import Place
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER


@dataclass(frozen=True)
class Removed:
    """What ``take_out_bad`` took out.

    Attributes:
        samples: split/id of the samples that were damaged.
        stacks: folders of PSF stacks that were.
    """

    samples: tuple[str, ...]
    stacks: tuple[str, ...]


def take_out_bad(root: Place, workers: int | str = 1, progress: Callable[[int, int], None] | None = None) -> Removed:
    """Check every byte and remove the samples and PSF stacks that are not as they were written, and their lines.

    Args:
        root: the data set; nobody else may be writing to it.
        workers: processes that check samples.
        progress: called with (samples checked, samples in all).

    Raises:
        InputError: ``dataset.json`` or the seal itself is damaged, which nothing here can tell apart from another data
            set, or another process is writing.
        StorageError: the folder is protected.
    """
    with ManifestWriter(root):
        hashes = read_seal(root) or {}
        changed = {str(error.path) for error in changed_files(root, hashes)}
        if str(root / FILE) in changed:
            raise InputError(
                root / FILE,
                f"has other content than {CHECKSUMS} says; restore it from a copy: it says what the rest is",
            )
        merge_lists(root, skip_bad=True)
        bad = verify(root, workers=workers, progress=progress).bad
        stacks = [name for name in (PSF_FOLDER, CAPTURED_FOLDER) if any(_is_in(path, root / name) for path in changed)]
        if not (bad or stacks):
            return Removed((), ())
        remove_file(root / CHECKSUMS)
        entries = load_manifest(root).entries
        rewrite_manifest(root, (entry for key, entry in entries.items() if key not in bad))
        for split, name in bad:
            remove_folder(sample_folder(root, split, sample_index(name)))
        for name in stacks:
            remove_folder(root / name)
    return Removed(tuple("/".join(key) for key in sorted(bad)), tuple(stacks))


def _is_in(path: str, folder: Place) -> bool:
    return path == str(folder) or path.startswith(f"{folder}/")
