"""Takes out of a data set what is damaged, so that the next run makes exactly that anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from simulator.dataset.checksums import CHECKSUMS, changed_files, read_seal
from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import ManifestWriter, merge_lists, rewrite_manifest
from simulator.dataset.sample import sample_folder, sample_index
from simulator.dataset.verification import Report, check_plain, verify
from simulator.errors import InputError
from simulator.io.files import UnreadableError, remove_file, remove_folder
from simulator.io.store import Place
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack


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
            set; a file cannot be read just now; there are links, or other files beside a damaged sample; another process is
            writing. Nothing is removed.
        StorageError: the folder is protected.
    """
    with ManifestWriter(root) as manifest:
        for line in check_plain(root):
            raise InputError(root, line)
        hashes = read_seal(root) or {}
        faults = list(changed_files(root, hashes))
        for error in faults:
            if isinstance(error, UnreadableError):
                raise error
        changed = {str(error.path) for error in faults}
        if str(root / FILE) in changed:
            raise InputError(
                root / FILE,
                f"has other content than {CHECKSUMS} says; restore it from a copy: it says what the rest is",
            )
        stacks = [
            name
            for name in (PSF_FOLDER, CAPTURED_FOLDER)
            if any(_is_in(path, root / name) for path in changed) or not _is_whole(root / name)
        ]
        merge_lists(manifest, skip_bad=True)
        report = verify(root, workers=workers, progress=progress)
        _refuse_doubt(root, report)
        if not (report.bad or stacks):
            return Removed((), ())
        remove_file(root / CHECKSUMS)
        rewrite_manifest(manifest, without=report.bad)
        for split, name in report.bad:
            remove_folder(sample_folder(root, split, sample_index(name)))
        for name in stacks:
            remove_folder(root / name)
    return Removed(tuple("/".join(key) for key in sorted(report.bad)), tuple(stacks))


def _refuse_doubt(root: Place, report: Report) -> None:
    """Refuse to remove anything where it is not sure that it is damaged, and nobody else's."""
    if report.unread:
        count, first = len(report.unread), "/".join(min(report.unread))
        raise InputError(
            root,
            f"{count} samples cannot be read, first {first}, which may be the fault of the disk or the network; nothing was "
            "removed. `flatlight verify` names them all; run this again when they can",
        )
    if both := report.bad & report.crowded:
        name = "/".join(min(both))
        raise InputError(
            root, f"{name} is damaged, and its folder holds other files; move those out, then run this again"
        )


def _is_whole(folder: Place) -> bool:
    """Whether a stack can be read; one that is not there is none to be mended.

    Raises:
        UnreadableError: the disk or the network fails.
    """
    try:
        if folder.exists():
            read_psf_stack(folder)
    except UnreadableError:
        raise
    except InputError:
        return False
    return True


def _is_in(path: str, folder: Place) -> bool:
    return path == str(folder) or path.startswith(f"{folder}/")
