"""The end of a data set: its lists merged, what it holds described and drawn, and the seal over all of it."""

from __future__ import annotations

from collections.abc import Callable

from simulator.dataset.card import write_card
from simulator.dataset.checksums import write_seal
from simulator.dataset.croissant import write_croissant
from simulator.dataset.manifest import ManifestWriter, merge_lists
from simulator.errors import InputError
from simulator.io.files import StorageError, UnreadableError
from simulator.io.store import Place


def complete(manifest: ManifestWriter, draw: Callable[[Place], object] | None) -> None:
    """Merge the lists, write ``README.md`` and ``croissant.json``, let the pages be drawn, and seal the data set.

    Args:
        manifest: the data set's, held by the one who writes alone.
        draw: called with the data set's folder before ``checksums.json`` seals it.

    Raises:
        InputError: a damaged sample.
        StorageError: the folder is protected, or the disk is full.
    """
    root = manifest.folder
    merge_lists(manifest)
    try:
        write_card(root)
        write_croissant(root)
        if draw is not None:
            draw(root)
    except (StorageError, UnreadableError):
        raise
    except InputError as error:
        cure = "flatlight generate --repair makes what is damaged anew"
        raise InputError(error.path, f"{error.reason}; {cure}") from error
    write_seal(root)
