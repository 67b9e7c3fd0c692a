"""How far a data set is, from its files alone: any machine that sees them can ask while others make it."""

from __future__ import annotations

from dataclasses import dataclass

from simulator.dataset.checksums import CHECKSUMS
from simulator.dataset.dataset_info import read_info
from simulator.dataset.manifest import (
    MANIFEST,
    FailedSample,
    Key,
    load_failed,
    load_manifest,
    load_skipped,
    writers_files,
)
from simulator.dataset.problems import shortened
from simulator.dataset.sample import sample_id
from simulator.dataset.shards import array_expression, shard_of
from simulator.errors import InputError
from simulator.io.store import Place, place
from simulator.text import counted, duration


@dataclass(frozen=True)
class Status:
    """How far a data set is.

    Attributes:
        wanted: samples per split.
        finished: samples per split.
        skipped: samples left out for good, per split.
        failed: samples that could not be made, and why.
        seconds: what a sample took on one worker, mean; None before the first.
        writers: lists that runs have not merged yet: of those that are at work, and of those that died.
        sealed: whether a run has come to its end: the next takes the seal off before it changes anything. What others have
            changed since, `verify` finds.
        missing: samples of every split that are neither finished nor skipped, by shard, where that was asked.
    """

    wanted: dict[str, int]
    finished: dict[str, int]
    skipped: dict[str, int]
    failed: dict[Key, FailedSample]
    seconds: float | None
    writers: int
    sealed: bool
    missing: tuple[int, ...] = ()

    @property
    def left(self) -> int:
        """How many samples are neither finished nor skipped."""
        return sum(self.wanted.values()) - sum(self.finished.values()) - sum(self.skipped.values())

    @property
    def shards(self) -> str:
        """The shards with missing samples as SLURM's ``--array`` takes them; empty where there is none."""
        return array_expression([index for index, count in enumerate(self.missing) if count])

    def __str__(self) -> str:
        lines = []
        for split, wanted in self.wanted.items():
            skipped = f", {self.skipped[split]} skipped" if self.skipped[split] else ""
            share = f" ({self.finished[split] / wanted:.1%})" if wanted else ""
            lines.append(f"{split}: {self.finished[split]} of {wanted} finished{share}{skipped}")
        if self.failed:
            lines.append(f"failed: {len(self.failed)}, which the next run tries again:")
            lines.append(shortened([f"{split}/{name}: {one.reason}" for (split, name), one in self.failed.items()]))
        if self.left:
            work = "" if self.seconds is None else f", about {duration(self.left * self.seconds)} of one worker"
            lines.append(f"left: {self.left}{work}")
            if self.missing:
                lines.append(f"shards with samples left, of {len(self.missing)}: --array={self.shards}")
        elif self.sealed:
            lines.append("complete and sealed")
        else:
            lines.append("complete, but not sealed: the same `flatlight generate` seals it")
        if self.writers:
            lines.append(
                f"{counted(self.writers, 'list')} of writers that are at work or died; the run that ends last merges them"
            )
        return "\n".join(lines)


def status(root: Place | str, shards: int | None = None) -> Status:
    """Say how far a data set is.

    Args:
        root: its folder, or its place in an object store.
        shards: number of shards, to name those with samples left.

    Raises:
        InputError: no data set, or a damaged list.
    """
    root = place(root)
    if shards is not None and shards < 1:
        raise InputError("--shards", f"got {shards}, expected at least 1")
    info, manifest, skipped = read_info(root), load_manifest(root), load_skipped(root)
    there = {key for key in [*manifest.entries, *skipped] if key[0] in info.counts}
    missing = [0] * (shards or 0)
    if shards is not None:
        for split, count in info.counts.items():
            for name in map(sample_id, range(count)):
                missing[shard_of(split, name, shards)] += (split, name) not in there
    seconds = [entry.seconds for entry in manifest.entries.values()]
    return Status(
        wanted=info.counts,
        finished={split: len(manifest.ids(split)) for split in info.counts},
        skipped={
            split: sum(1 for key in skipped if key[0] == split and key not in manifest.entries) for split in info.counts
        },
        failed=load_failed(root),
        seconds=sum(seconds) / len(seconds) if seconds else None,
        writers=len({str(path.parent) for path in writers_files(root, MANIFEST)}),
        sealed=(root / CHECKSUMS).exists(),
        missing=tuple(missing),
    )
