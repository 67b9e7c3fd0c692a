"""What a network for clips learns from: captures, frames, and what is expensive to compute of them, kept in a file.

The joint least squares that many networks begin with take longer than a step of its training. So a clip is changed and
re-simulated a fixed number of times, and each time is worked out once, by whichever process needs it first. A GPU, which
computes many estimates in the time of one, works them all out before the first step.
"""

from __future__ import annotations

import copy
import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset as TorchDataset

from learning.camera import CaptureModel
from learning.config import ActivityTrainConfig, Video3DTrainConfig, VideoTrainConfig
from learning.data import Arrays, Draw, ExampleSet, Loader, SampleCache, clip_of, read_scene
from learning.method import torch_threads
from learning.provenance import sample_digests
from learning.simulate import SceneCamera
from simulator.dataset.reader import Dataset
from simulator.io.cache import code_digest
from simulator.io.files import sha256_bytes, storage_errors

_CHECKSUM = 4  # bytes; of nothing but zeros it is not 0, so that a hole in the file is no record


class ClipExample(NamedTuple):
    """A capture and its frames; what a training does not need is empty. Batches have a leading B.

    Attributes:
        measurement: ``(C, H, W)`` float32, DN / 2^bits.
        radiance: ``(N, 3, h, w)`` float32, linear sRGB, the means of the slivers.
        start: the network's initial estimate; of a VideoNet ``(N, C, rows, columns)``.
        measured: ``(N, C, H, W)``, what a global shutter would have measured of each sliver, without noise.
        label: ``()`` int64, the number of the clip's class.
        depth_m: ``(N, 1, h, w)`` float32, metres, in the middle of each sliver; 0 where nothing was seen.
    """

    measurement: Tensor
    radiance: Tensor
    start: Tensor
    measured: Tensor
    label: Tensor
    depth_m: Tensor = torch.empty(0)


class InitialEstimator(Protocol):
    """The module that computes a network's initial estimate."""

    @property
    def told(self) -> Mapping[str, Any]:
        """What decides it beside the camera, plain."""
        ...

    def cpu(self) -> Any:
        """Move it to the CPU."""
        ...

    def __call__(self, measurement: Tensor, /) -> Tensor:
        """Return the estimate of measurements ``(B, C, H, W)``."""
        ...


class ClipExamples(TorchDataset[ClipExample]):
    """The clips of an `ExampleSet` with what a network for them needs.

    Attributes:
        dataset: the split.
        labels: of each clip, the number of its class; None where classes do not matter.
    """

    def __init__(
        self,
        examples: ExampleSet,
        initial_estimate: Callable[[Tensor], Tensor | None],
        *,
        identity: Mapping[str, Any],
        white: float,
        measured: bool,
        draws: int,
        cache: Path | None,
        labels: Sequence[int] | None = None,
        depth: bool = False,
        on_gpu: bool = False,
    ) -> None:
        """Prepare; a training's examples are worked out when they are asked for.

        Args:
            examples: the clips, changed and re-simulated or as they are stored.
            initial_estimate: that of measurements ``(1, C, H, W)``, or None where there is none.
            identity: all that decides initial estimates and the draws of ``examples``, code too: the key of what is kept.
            white: reference white, in units of which radiance is kept.
            measured: whether global measurements are wanted.
            draws: how many times each clip is changed, or its noise drawn; 0 does so for every draw, of which nothing is
                kept.
            cache: folder to keep examples in; None keeps nothing.
            labels: see above.
            depth: whether depths are wanted.
            on_gpu: whether the network is on a GPU: of what is not kept, it computes the start itself.
        """
        self.dataset, self._examples, self._initial_estimate = examples.dataset, examples, initial_estimate
        self._draws = draws if examples.redrawn else 1
        self._measured, self._white, self._depth, self.labels = measured, np.float32(white), depth, labels
        self._camera = SceneCamera(examples.dataset) if measured else None
        self._scene = partial(read_scene, examples.dataset, timing=examples.timing)
        self._kept: KeptRecords | None = None
        if cache is not None and measured:
            self._scene = SampleCache.filled(cache, examples.dataset, "scene", self._scene).read
        if cache is not None and self._draws:
            frames = None if examples.timing is None else examples.timing.frames
            told = [
                dict(identity),
                white,
                frames,
                sample_digests(examples.dataset),
                examples.dataset.ids,
                self._draws,
                depth,
            ]
            name = sha256_bytes(repr(told).encode())[:32]
            self._kept = KeptRecords(cache / f"{name}.clips", self._worked_out(0, 0))
        elif on_gpu:
            self._initial_estimate = _InitialEstimate(None)  # the network does it

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self._examples)

    def __getitem__(self, draw: Draw | int) -> ClipExample:
        """Return a clip; a plain position is draw number 0."""
        position, number = self._version(draw) if isinstance(draw, tuple) else (draw, 0)
        at = self._place(position, number)
        arrays = None if self._kept is None else self._kept.read(at)
        if arrays is None:
            arrays = self._worked_out(position, number)
            if self._kept is not None:
                self._kept.write(at, arrays)
        seen = self._seen(position, number) if self._measured else np.empty(0, np.float32)
        radiance = arrays["radiance"].astype(np.float32) * self._white
        every = (arrays["measurement"], radiance, arrays["start"], seen, arrays["depth_m"])
        label = torch.empty(0, dtype=torch.int64) if self.labels is None else torch.tensor(self.labels[position])
        measurement, radiance, start, seen, depth_m = (torch.from_numpy(values.astype(np.float32)) for values in every)
        return ClipExample(measurement, radiance, start, seen, label, depth_m)

    def missing(self, draws: Iterable[Draw], rank: int = 0, world_size: int = 1) -> list[Draw]:
        """Return which versions of these draws are not kept yet, of one process's share; none where nothing is kept."""
        if self._kept is None:
            return []
        versions = list(dict.fromkeys(map(self._version, draws)))[rank::world_size]
        return [version for version in versions if not self._kept.holds(self._place(*version))]

    def estimate_ahead(
        self, versions: Sequence[Draw], initial_estimate: Callable[[Tensor], Tensor], at_once: int, workers: int
    ) -> Iterator[int]:
        """Work out and keep versions that are `missing`; yield after each part how many it had.

        Args:
            versions: see `missing`.
            initial_estimate: that of measurements ``(B, C, H, W)``, as a rule on a GPU.
            at_once: B.
            workers: how many processes simulate the captures.
        """
        if self._kept is None or not versions:
            return
        loader = Loader(_WithoutStart(self, self.dataset), [[version] for version in versions], workers)
        try:
            simulated = iter(loader)
            for first in range(0, len(versions), at_once):
                part = versions[first : first + at_once]
                known = [next(simulated) for _ in part]
                starts = initial_estimate(torch.cat([one.measurement for one in known])).to("cpu", torch.float16)
                for version, one, start in zip(part, known, starts, strict=True):
                    arrays = {name: values[0].numpy() for name, values in one._asdict().items()}
                    self._kept.write(self._place(*version), arrays | {"start": start.numpy()})
                yield len(part)
        finally:
            loader.close()

    def _version(self, draw: Draw) -> Draw:
        """Return the draw under which another is kept."""
        return draw._replace(number=draw.number % self._draws) if self._draws else draw

    def _place(self, position: int, number: int) -> int:
        return position * self._draws + number

    def _worked_out(self, position: int, number: int) -> Arrays:
        known = self._simulated(position, number)
        with torch_threads(1):  # beside the training, and the other workers
            start = self._initial_estimate(known.measurement[None])
        first = torch.empty(0) if start is None else start[0]
        arrays = {name: values.numpy() for name, values in known._asdict().items()}
        return arrays | {"start": first.to(torch.float16).numpy()}

    def _simulated(self, position: int, number: int) -> _Simulated:
        """Return a draw as it is kept, but for its start."""
        example = self._examples[Draw(position, number)]
        seen = torch.where(example.valid, example.depth_m, 0) if self._depth else torch.empty(0)
        radiance = torch.from_numpy((example.radiance.numpy() / self._white).astype(np.float16))
        return _Simulated(example.measurement, radiance, seen.to(torch.float16))

    def _seen(self, position: int, number: int) -> NDArray[np.float32]:
        """Return the global measurements of the clip as this draw has changed it."""
        assert self._camera is not None
        assert self._examples.timing is not None
        clip = clip_of(self._scene(position))
        if self._examples.augment is not None:
            clip = self._examples.augment.apply(clip, self._examples.generator(position, number))
        return self._camera.global_measurements(clip, self._examples.timing.frames)


def open_clip_examples(
    dataset: Dataset,
    config: VideoTrainConfig | Video3DTrainConfig | ActivityTrainConfig,
    capture: CaptureModel,
    *,
    joint: InitialEstimator | None,
    measured: bool,
    cache: Path | None,
    on_gpu: bool,
    labels: Sequence[int] | None = None,
    depth: bool = False,
) -> ClipExamples:
    """Return a split's examples for a training: ``joint`` computes its network's initial estimate, where it has one.

    See `ClipExamples` for the others.
    """
    augment = config.data.augment if dataset.split == "train" else None
    # The clips that are kept are the same for all seeds, which then differ in weights and order.
    kept = config.data.draws or (augment is None and config.data.noise_db is None)
    seed = 0 if kept else config.seed
    examples = ExampleSet(dataset, noise_db=config.data.noise_db, augment=augment, seed=seed, cache=cache)
    identity = {"seed": seed, "augment": augment and vars(augment), "noise_db": config.data.noise_db}
    # With all that they import, what makes the same draw of a clip, and its initial estimate, another one.
    deciding = (__name__,) if joint is None else (__name__, type(joint).__module__)
    identity |= {"stack": capture.stack.fingerprint, "start": joint and joint.told, "code": code_digest(*deciding)}
    identity |= {"on_gpu": on_gpu}  # where sums are rounded otherwise
    return ClipExamples(
        examples,
        _InitialEstimate(joint),
        identity=identity,
        white=capture.white,
        measured=measured,
        draws=config.data.draws,
        cache=cache,
        labels=labels,
        depth=depth,
        on_gpu=on_gpu,
    )


class _Simulated(NamedTuple):
    """A draw without its start; but for the measurement in half precision, of which a loss sees nothing."""

    measurement: Tensor
    radiance: Tensor
    depth_m: Tensor


@dataclass
class _WithoutStart(TorchDataset[_Simulated]):
    """Clips as they are kept, but for their starts."""

    examples: ClipExamples
    dataset: Dataset

    def __len__(self) -> int:
        return len(self.examples)

    def __getitem__(self, draw: Draw | int) -> _Simulated:
        return self.examples._simulated(*(draw if isinstance(draw, tuple) else (draw, 0)))


class _InitialEstimate:
    """A network's initial estimate without the network, which may be on a GPU: for the processes that read examples."""

    def __init__(self, joint: InitialEstimator | None) -> None:
        self._joint = copy.deepcopy(joint)
        if self._joint is not None:
            self._joint.cpu()

    def __call__(self, measurement: Tensor) -> Tensor | None:
        return None if self._joint is None else self._joint(measurement)


class KeptRecords:
    """Records of one kind in a file, each written once, by any process, when it was worked out.

    Each begins with its checksum, which a place that was never written, or not wholly, does not match; two processes that
    write the same record write the same bytes, or on a GPU such that differ by rounding. Plain reads and writes: of a full
    disk they raise an error, where a memory map would crash.
    """

    def __init__(self, path: Path, like: Mapping[str, NDArray[Any]]) -> None:
        """Open the file, or begin it; ``like`` is a record of its kind. A StorageError says that it cannot be."""
        self._path = path
        self._kind = np.dtype([(name, values.dtype, values.shape) for name, values in like.items()])
        self._descriptor: int | None = None
        with storage_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open()

    def read(self, at: int) -> dict[str, NDArray[Any]] | None:
        """Return a record's arrays, None where it was not written yet, or is damaged."""
        size = _CHECKSUM + self._kind.itemsize
        stored = os.pread(self._open(), size, at * size)
        content = stored[_CHECKSUM:]
        if len(stored) < size or stored[:_CHECKSUM] != _checksum(content):
            return None
        record = np.frombuffer(content, self._kind)[0]
        return {name: record[name] for name in self._kind.names or ()}

    def holds(self, at: int) -> bool:
        """Return whether a record was written; `read` also knows whether it is damaged, and takes longer."""
        first = os.pread(self._open(), _CHECKSUM, at * (_CHECKSUM + self._kind.itemsize))
        return len(first) == _CHECKSUM and any(first)

    def write(self, at: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep a record."""
        record = np.zeros((), self._kind)
        for name, values in arrays.items():
            record[name] = values
        content = record.tobytes()
        content = _checksum(content) + content
        first = at * len(content)
        with storage_errors(self._path):
            while content:  # of a nearly full disk, the system takes a part and says so
                taken = os.pwrite(self._open(), content, first)
                content, first = content[taken:], first + taken

    def _open(self) -> int:
        if self._descriptor is None:
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        return self._descriptor

    def __getstate__(self) -> dict[str, Any]:
        """Leave the descriptor out, which is this process's."""
        return self.__dict__ | {"_descriptor": None}


def _checksum(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CHECKSUM, "little")
