"""A data set as learning and evaluation see it: tensors, with the stored noise or any other, the same in every process."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Sampler, default_collate
from torch.utils.data import Dataset as TorchDataset

from learning.camera import recorded_sensor
from learning.provenance import sample_digests
from learning.simulate import Augmentation, SceneCamera
from learning.timing import Timing, recorded_timing, sample_timing
from simulator.camera.noise import GaussianNoise, PhysicalNoise, add_gaussian
from simulator.camera.sensor import Sensor
from simulator.camera.slivers import sliver_means
from simulator.config import config_from_dict
from simulator.dataset.reader import Dataset
from simulator.dataset.sample import SPLITS, StoredSample, sample_index
from simulator.errors import InputError
from simulator.io.files import committed_folder, sha256_bytes, storage_errors
from simulator.io.locks import take_lock
from simulator.types import Clip, Surroundings

Arrays = dict[str, NDArray[Any]]
"""What is kept of a sample: the arrays of an `Example`; in place of the measurement also it without noise, or the scene."""

Item = TypeVar("Item", bound=tuple[Tensor, ...])
Item_co = TypeVar("Item_co", bound=tuple[Tensor, ...], covariant=True)

_STREAM = 6  # apart from the simulator's streams of the same seed, whose keys are shorter
_CHECKED = 16
_NOISE_PILOTS, _NOISELESS_DB = 16, 120.0
CACHE, _CACHE_FORMAT = "samples.npy", 3


class Example(NamedTuple):
    """A measurement and what was there; ``default_collate`` makes batches of the same kind with a leading B.

    Attributes:
        measurement: ``(C, H, W)`` float32, DN / 2^bits.
        radiance: ``(3, h, w)`` float32, linear sRGB; of a clip ``(N, 3, h, w)``, the mean of each sliver's frames.
        depth_m: ``(1, h, w)`` float32, metres; of a clip ``(N, 1, h, w)``, in the middle of each sliver.
        valid: bool, like ``depth_m``; False where nothing was seen, which lies at the far depth.
    """

    measurement: Tensor
    radiance: Tensor
    depth_m: Tensor
    valid: Tensor


class Draw(NamedTuple):
    """A sample by its position in its split, and the noise it is seen with: another number is another noise."""

    position: int
    number: int


class ExampleSet(TorchDataset[Example]):
    """One split of a data set, ``dataset``, of stills or of clips; picklable, for workers that are forked or spawned.

    Attributes:
        timing: of its clips, which all have the same; None of stills.
        augment: how scenes are changed before they are re-simulated; None takes them as stored.
        redrawn: whether another draw of a sample is another example.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        noise_db: tuple[float, float] | None = None,
        augment: Augmentation | None = None,
        seed: int = 0,
        cache: Path | None = None,
    ) -> None:
        """Look at the data set; samples are read when they are asked for, or now, where there is a cache to be filled.

        Args:
            dataset: the split.
            noise_db: None gives the measurements as stored. A range redraws white Gaussian noise on the noiseless ones: half
                of the PSNRs lie in the upper quarter of the range, in decibels; the peak is the sample's greatest noiseless
                value above darkness; the result is clipped and quantised as the data set's own noise is (physical noise is
                always clipped; a mean of binned pixels has steps too fine to matter).
            augment: how scenes are changed and re-simulated, by the data set's own camera; None takes them as stored.
            seed: decides, with the split, the sample's id and the draw's number, change, level and noise.
            cache: folder for decoded samples, shared by processes and runs; see `SampleCache`.

        Raises:
            InputError: an empty split, mosaics, levels that make no sense, or samples that cannot be re-simulated.
        """
        self.timing = recorded_timing(dataset)
        if len(dataset) == 0:
            cure = f"set dataset.{dataset.split} and run `flatlight generate` again, or give another data set"
            raise InputError(dataset.root, f"split {dataset.split!r} is empty; {cure}")
        if noise_db is not None and not 0 < noise_db[0] <= noise_db[1] <= 120:
            raise InputError("noise_db", f"got {noise_db}, expected a range of PSNRs such as (20, 50), in 0 to 120 dB")
        if augment is not None and self.timing is not None and dataset.info.time.get("ground_truth") != "frames":
            reason = f"{dataset.root} stores only the mean of each sliver, from which no capture can be simulated"
            raise InputError(
                "data.augment", f"{reason}; generate it with dataset.ground_truth: frames, or leave it out"
            )
        self.dataset, self._noise_db, self.augment, self._seed = dataset, noise_db, augment, seed
        self.redrawn = augment is not None or noise_db is not None
        self._sensor, self._dark, self._clip, self._quantise = _converter(dataset)
        self._camera = None if augment is None else SceneCamera(dataset)
        self._kind = "scene" if augment else "measurement" if noise_db is None else "noiseless"
        # Of a clip, a scene is all of its frames, anything else has the slivers' means beside it.
        kept = (
            self._kind if self._kind == "scene" or self.timing is None else f"{self._kind}, {self.timing.frames} frames"
        )
        self._cache = None if cache is None else SampleCache.filled(cache, dataset, kept, self._read)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.dataset)

    def __getitem__(self, draw: Draw | int) -> Example:
        """Return a sample; a plain position is draw number 0. An InputError names the file of a damaged sample."""
        position, number = draw if isinstance(draw, tuple) else (draw, 0)
        arrays = self._read(position) if self._cache is None else self._cache.read(position)
        rng = self.generator(position, number)
        if self.augment is not None and self._camera is not None:
            clip = self.augment.apply(clip_of(arrays), rng)
            exposure = self._camera.exposure(clip)
            sensor = self._camera.sensor
            seen = sensor.expose(exposure, rng) if self._noise_db is None else sensor.noiseless(exposure)
            arrays = {"measurement": seen, **_truth(clip, self.timing)}
        measurement = arrays["measurement"]
        if self._noise_db is not None:
            least, greatest = self._noise_db
            psnr_db = greatest - (greatest - least) * rng.random() ** 2
            std = max(float(measurement.max()) - self._dark, 0.0) * 10 ** (-psnr_db / 20)
            noise = GaussianNoise(std=std, clip=self._clip, quantise=self._quantise)
            measurement = add_gaussian(measurement, noise, self._sensor.bit_depth, rng)
        truth = (arrays[name] for name in ("radiance", "depth_m", "valid"))
        return Example(*(torch.from_numpy(np.ascontiguousarray(values)) for values in (measurement, *truth)))

    def generator(self, position: int, number: int) -> np.random.Generator:
        """Return the generator of a draw, by which first the scene is changed, then noise is drawn."""
        split, index = SPLITS.index(self.dataset.split), sample_index(self.dataset.ids[position])
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(_STREAM, split, index, number)))

    def _read(self, position: int) -> Arrays:
        if self._kind == "scene":
            return read_scene(self.dataset, position, self.timing)
        stored = self.dataset.stored(position)
        truth = _truth(_stored_clip(self.dataset, stored, self.timing), self.timing)
        measurement, noiseless = stored.measurement()
        return {"measurement": measurement if self._kind == "measurement" else noiseless, **truth}


def read_scene(dataset: Dataset, position: int, timing: Timing | None = None) -> Arrays:
    """Return what was there, by the names of `Example`, and what shone beside it, where that is known.

    Of clips, which have a ``timing``, all frames as they are stored, and their edges.
    """
    stored = dataset.stored(position)
    clip, around = _stored_clip(dataset, stored, timing), stored.surroundings()
    arrays = _arrays(clip)
    if around is not None:
        arrays |= {"light_beside": around.rgb, "depth_beside": around.depth_m}
    if timing is None:
        arrays = {name: values[0] for name, values in arrays.items()}
    else:
        arrays |= {"frame_edges_s": clip.frame_edges_s}
    return arrays if around is None else arrays | {"coarseness": np.array(around.coarseness)}


def _stored_clip(dataset: Dataset, stored: StoredSample, timing: Timing | None) -> Clip:
    """Return the frames of a sample, without what shone beside them; an InputError refuses other times than the others'."""
    own = sample_timing(dataset, stored)
    if (own is None) != (timing is None):
        got, expected = ("a still", "a clip") if own is None else (f"a clip of {stored.frames} frames", "a still")
        raise InputError(stored.folder, f"got {got}, expected {expected} like the other samples")
    if own is not None and timing is not None:
        try:
            own.check_same(timing, dataset.info.sensor_shape[0])
        except InputError as error:
            raise InputError(stored.folder, f"{error.path} differs from the other samples': {error.reason}") from error
    frames = [stored.frame(number) for number in range(stored.frames)]
    rgb, depth_m, valid = (np.stack([getattr(frame, name) for frame in frames]) for name in ("rgb", "depth_m", "valid"))
    if depth_m.min() <= 0:
        raise InputError(stored.folder, f"got a depth of {depth_m.min():g} m, expected depths above 0")
    return Clip(rgb, depth_m, valid, np.array([0.0, 1.0]) if stored.frame_edges_s is None else stored.frame_edges_s)


def _arrays(clip: Clip) -> Arrays:
    """Return the frames of a clip by the names of `Example`, with a leading T."""
    return {
        "radiance": np.moveaxis(clip.rgb, -1, 1),
        "depth_m": clip.depth_m[:, None],
        "valid": clip.valid[:, None],
    }


def _truth(clip: Clip, timing: Timing | None) -> Arrays:
    """Return what an estimate is compared with: a still, or the slivers' means."""
    if timing is None:
        return {name: values[0] for name, values in _arrays(clip).items()}
    return _arrays(sliver_means(clip, timing.frames))


def clip_of(arrays: Arrays) -> Clip:
    """Return the scene of what `read_scene` gave."""
    still = "frame_edges_s" not in arrays
    edges_s = np.array([0.0, 1.0]) if still else arrays["frame_edges_s"]

    def frames(name: str) -> NDArray[Any]:
        return arrays[name][None] if still else arrays[name]

    around = None
    if "light_beside" in arrays:
        around = Surroundings(frames("light_beside"), frames("depth_beside"), int(arrays["coarseness"]))
    rgb = np.moveaxis(frames("radiance"), 1, -1)
    return Clip(rgb, frames("depth_m")[:, 0], frames("valid")[:, 0], edges_s, surroundings=around)


def _converter(dataset: Dataset) -> tuple[Sensor, float, bool, bool]:
    """Return the sensor, what it stores in darkness, and whether measurements are clipped, and rounded to whole DN."""
    config = config_from_dict(dataset.config, dataset.root, check_plugins=False)
    if (readout := config.camera.sensor.readout) != "binned_rgb":
        reason = f"camera.sensor.readout is {readout}; reconstruction needs all colours in a pixel (binned_rgb)"
        raise InputError(dataset.root, reason)
    sensor = recorded_sensor(dataset.info, config)
    noise = config.camera.noise
    if isinstance(noise, GaussianNoise):
        return sensor, 0.0, noise.clip, noise.quantise
    if not isinstance(noise, PhysicalNoise):
        return sensor, 0.0, False, False
    return sensor, sensor.black_level_dn / 2**sensor.bit_depth, True, sensor.binning == 1


def check_dataset(dataset: Dataset) -> None:
    """Refuse a data set from which nothing can be learned; a few samples are read.

    Raises:
        InputError: an empty split, mosaics, a sample with NaN, inf or other damage; of stills also one depth everywhere.
    """
    examples = ExampleSet(dataset)
    near, far = np.inf, 0.0
    for position in np.unique(np.linspace(0, len(dataset) - 1, _CHECKED).astype(int)).tolist():
        example = examples[position]
        seen = example.depth_m[example.valid]
        if len(seen):
            near, far = min(near, float(seen.min())), max(far, float(seen.max()))
    if near >= far and examples.timing is None:
        what = f"all scenes are at {far:g} m" if far > 0 else "no pixel of its scenes is valid"
        reason = f"split {dataset.split!r} says nothing about depth: {what}; use scenes or a source with depth"
        raise InputError(dataset.root, reason)


def measured_psnr_db(dataset: Dataset) -> float:
    """Return the mean PSNR of a data set's first 16 measurements; 120 dB without noise.

    The peak is the noiseless measurement's above darkness: of a dim image nearly all is black level.
    """
    levels, (_, dark, *_) = [], _converter(dataset)
    for position in range(min(len(dataset), _NOISE_PILOTS)):
        measurement, noiseless = dataset.stored(position).measurement()
        error = float(np.sqrt(np.mean((measurement - noiseless).astype(np.float64) ** 2)))
        peak = max(float(noiseless.max()) - dark, 0.0)
        levels.append(20 * np.log10(peak / error) if error > 0 and peak > 0 else _NOISELESS_DB)
    return float(min(np.mean(levels), _NOISELESS_DB))


class Batches(Sampler[list[Draw]]):
    """Endless batches: which samples a training step sees, decided by the seed and the step's number alone.

    An epoch is a permutation of all samples, and epochs follow each other without a gap: a batch may hold the end of one and
    the beginning of the next. The epoch's number is the number of the draw. Batch ``n`` depends on ``seed`` and ``n`` alone,
    so a loader that starts at ``first = n`` goes on where another stopped.
    """

    def __init__(
        self, length: int, batch: int, *, seed: int, first: int = 0, rank: int = 0, world_size: int = 1
    ) -> None:
        """Set the order of ``length`` samples in batches of ``batch``, from number ``first`` on.

        ``world_size`` processes share each batch, which they must divide; ``rank`` says which part is given here.
        """
        self._length, self._batch, self._seed, self._first = length, batch, seed, first
        part = batch // world_size
        self._part = slice(rank * part, (rank + 1) * part)
        self._order: tuple[int, NDArray[np.intp]] | None = None

    def __iter__(self) -> Iterator[list[Draw]]:
        """Yield the batches from ``first`` on, without end."""
        yield from map(self.batch, itertools.count(self._first))

    def batch(self, number: int) -> list[Draw]:
        """Return this rank's part of a batch."""
        places = range(number * self._batch, (number + 1) * self._batch)[self._part]
        return [self._draw(*divmod(place, self._length)) for place in places]

    def _draw(self, epoch: int, place: int) -> Draw:
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(epoch,)))
            self._order = epoch, rng.permutation(self._length)
        return Draw(int(self._order[1][place]), epoch)


class Examples(Protocol[Item_co]):
    """What a training reads: a named tuple of tensors for each sample of a split, and for each draw of it."""

    dataset: Dataset

    def __len__(self) -> int:
        """Return the number of samples."""
        ...

    def __getitem__(self, draw: Draw | int, /) -> Item_co:
        """Return a sample; a plain position is draw number 0."""
        ...


class Loader(Generic[Item]):
    """Batches of examples, read by worker processes that end with `close`; bad input comes out of them as it is raised."""

    def __init__(
        self,
        examples: Examples[Item],
        order: Sampler[list[Draw]] | Sequence[list[Draw]] | Sequence[list[int]],
        workers: int,
        *,
        pin_memory: bool = False,
    ) -> None:
        """Set up the workers, which begin to read with the first batch; 0 read in this process."""
        self._loader = DataLoader(
            _Guarded(examples),
            batch_sampler=order,
            collate_fn=itemgetter(0),
            num_workers=workers,
            pin_memory=pin_memory,
            worker_init_fn=_ignore_signals,
            persistent_workers=workers > 0,
            generator=torch.Generator(),  # its own: the loader draws a number from it that nothing uses
        )

    def __iter__(self) -> Iterator[Item]:
        """Yield batches in their order; an InputError is that of `ExampleSet`."""
        for found in self._loader:
            if isinstance(found, InputError):
                raise found
            yield found

    def close(self) -> None:
        """End the workers now: left to Python, they live as long as anything, such as a traceback, refers to them."""
        iterator = self._loader._iterator
        if iterator is not None:
            # Torch has no public way, and of its iterators only that with workers has this one
            iterator._shutdown_workers()  # pyright: ignore[reportAttributeAccessIssue]
            self._loader._iterator = None


@dataclass(frozen=True)
class _Guarded(TorchDataset[Any]):
    """One batch, or the refusal to read it as a value: raised, torch would wrap it in a traceback's text."""

    examples: Examples[Any]

    def __getitems__(self, draws: Iterable[Draw | int]) -> list[Any]:
        try:
            return [default_collate([self.examples[draw] for draw in draws])]
        except InputError as error:
            return [error]


def _ignore_signals(_: int) -> None:
    """Let a worker live on after a signal that asks the training to stop and reaches it too, until the loop has finished."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


class SampleCache:
    """Decoded samples of one split: records in one memory-mapped .npy file, opened anew in every process.

    An epoch then costs no decoding, and processes share the memory. The folder's name is a hash of the samples' digests, so
    samples that were made again are never served from an older cache. It appears in one rename when all of it is on the
    disk; processes that want the same one wait for its writer.
    """

    def __init__(self, folder: Path, length: int) -> None:
        """Name a cache that was filled, of so many samples; see `filled`."""
        self._file, self._length = folder / CACHE, length
        self._records: NDArray[np.void] | None = None

    @classmethod
    def filled(cls, folder: Path, dataset: Dataset, kind: str, read: Callable[[int], Arrays]) -> SampleCache:
        """Return the cache of a split below ``folder``, which is written first where it is not there or not whole.

        ``kind`` says what of a sample is kept, so that caches of several kinds lie apart; ``read`` gives it, of one sample as
        of all others.

        Raises:
            InputError: a sample cannot be read.
            StorageError: the cache cannot be written.
        """
        identity = repr((_CACHE_FORMAT, kind, dataset.split, dataset.ids, sample_digests(dataset)))
        own = folder / sha256_bytes(identity.encode())[:32]
        cache = cls(own, len(dataset))
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        lock = own.with_name(f"{own.name}.lock")
        with ExitStack() as stack:
            with storage_errors(lock):  # of the lock alone: what goes wrong under it is another matter
                held = stack.enter_context(open(lock, "ab"))
                take_lock(
                    held, wait=True
                )  # where there are no locks, two may write the same cache: the later one's stays
            if not cache._is_whole():
                cache._write(dataset, read)
        return cache

    def read(self, position: int) -> Arrays:
        """Return a sample's arrays, copied: what the caller changes stays the caller's."""
        if self._records is None:
            self._records = self._open()
        record = self._records[position]
        return {name: np.array(record[name]) for name in record.dtype.names or ()}

    def __getstate__(self) -> dict[str, Any]:
        """Leave the map out: pickled, it would be the whole data set."""
        return self.__dict__ | {"_records": None}

    def _open(self) -> NDArray[np.void]:
        return np.load(self._file, mmap_mode="r", allow_pickle=False)

    def _write(self, dataset: Dataset, read: Callable[[int], Arrays]) -> None:
        """Write one sample after another to a plain file: there, a full disk raises an error; a memory map would crash."""
        with committed_folder(self._file.parent) as temporary, open(temporary / CACHE, "wb") as file:
            record = None
            for position in range(len(dataset)):
                try:
                    arrays = read(position)
                except OSError as error:  # not one to write the cache
                    cure = f"({error.strerror or error}); check the disk, or restore the sample"
                    raise InputError(dataset.folder(position), f"cannot be read {cure}") from error
                if record is None:
                    record = np.zeros((), [(name, values.dtype, values.shape) for name, values in arrays.items()])
                    kind = np.lib.format.dtype_to_descr(record.dtype)
                    header = {"descr": kind, "fortran_order": False, "shape": (len(dataset),)}
                    np.lib.format.write_array_header_1_0(file, header)
                for name in record.dtype.names or ():
                    record[name] = arrays[name]
                file.write(record.tobytes())
            file.flush()
            os.fsync(file.fileno())

    def _is_whole(self) -> bool:
        try:
            return self._open().shape == (self._length,)
        except (OSError, ValueError):  # absent, or a header or length that is not an array's
            return False
