"""NPZ: one compressed file of NumPy arrays per sample, that ``numpy.load`` reads without pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simulator.dataset.exports.output import Output, Progress, write_files
from simulator.dataset.exports.source import Source, arrays
from simulator.dataset.sample import DESCRIPTION
from simulator.dataset.verification import CheckedSample
from simulator.io.store import relative_name

_EARLIEST = (1980, 1, 1, 0, 0, 0)  # that a zip file can name: the time of every member


def write(source: Source, output: Output, shard_bytes: int, progress: Progress) -> None:
    """Write ``train/0000/s00000012.npz`` and so on; ``shard_bytes`` decides nothing.

    Names are those of `arrays`, ``label`` where a sample has one, and ``sample_json``, the text of its description; errors
    as `write_files`.
    """
    write_files(
        source,
        output,
        progress,
        runs=lambda entries: ((entry,) for entry in entries),
        name=lambda _split, _number, entry: f"{relative_name(source.folder(entry), source.root)}.npz",
        writer=_open,
    )


@contextmanager
def _open(path: Path) -> Iterator[Callable[[CheckedSample], None]]:
    with zipfile.ZipFile(path, "w") as archive:

        def add(sample: CheckedSample) -> None:
            assert sample.sample is not None
            texts = {"sample_json": sample.files[DESCRIPTION].decode()}
            if sample.sample.label is not None:
                texts["label"] = sample.sample.label
            values = arrays(sample.sample) | {name: np.array(text) for name, text in texts.items()}
            for name in sorted(values):
                info = zipfile.ZipInfo(f"{name}.npy", _EARLIEST)
                info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
                with archive.open(info, "w", force_zip64=True) as stream:
                    np.lib.format.write_array(stream, values[name], allow_pickle=False)

        yield add
