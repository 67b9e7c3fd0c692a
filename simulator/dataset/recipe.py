"""The recipe of one sample: from (configuration, split, index) to measurement and ground truth.

A worker builds its ``SampleMaker`` once and then makes any sample of the data set, alike in every process and order.
"""

from __future__ import annotations

import io
import platform
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from simulator.assembly import Assembly
from simulator.camera.colour import clipped_share
from simulator.camera.noise import GaussianNoise
from simulator.camera.planes import clamped_share
from simulator.camera.shutter import Shutter
from simulator.camera.slivers import exposed_part, sliver_means
from simulator.camera.surroundings import surrounded
from simulator.config import Config
from simulator.config.schema import DatasetConfig
from simulator.dataset.clips import ClipOrder, check_clip, clip_order, durations_s
from simulator.dataset.engines import Outcome, available_cpus, run
from simulator.dataset.fingerprint import cpu_level, installed_versions
from simulator.dataset.sample import (
    DESCRIPTION,
    Sample,
    SampleRecord,
    digest_of,
    read_description,
    sample_folder,
    sample_id,
    write_sample,
)
from simulator.errors import InputError
from simulator.io.files import sha256_bytes, write_atomic
from simulator.io.store import Place, StorePath
from simulator.optics.stack_files import read_psf_stack
from simulator.plugins import plugin_errors
from simulator.seeds import generator
from simulator.types import FARTHEST_M, Clip, SceneSource, View


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the samples; small enough to send to workers.

    Attributes:
        config: the configuration.
        backend: Mitsuba variant, or ``none`` for imported scenes.
        psf_folder: the data set's PSF stack.
        source: the scene source, or None where workers must build it themselves (classes in a user's own file).
        full_scale: exposure at full scale; None while it is being found from pilot samples.
        versions: packages that every worker must have in these versions, or its samples would be others.
        shutter: the shutter, built once so that all samples share its windows.
        view: what scenes are drawn for; an automatic margin takes a second to find.
    """

    config: Config
    backend: str
    psf_folder: Place
    source: SceneSource | None
    shutter: Shutter
    view: View
    full_scale: float | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


class SampleMaker:
    """A recipe with its tools laid out: PSF spectra, shutter, sensor, scene source.

    Attributes:
        scene_s: seconds that the scene of the last sample took.
        cpu: level of this machine's processor.
    """

    scene_s = 0.0

    def __init__(self, recipe: Recipe) -> None:
        """Read the PSF stack and prepare the forward model: about a second."""
        self.cpu = cpu_level()
        self._seed, self._chosen = recipe.config.seed, recipe.config.dataset
        self._stack = read_psf_stack(recipe.psf_folder)
        assembly = Assembly(recipe.config, recipe.backend).having(
            psf_stack=self._stack, shutter=recipe.shutter, view=recipe.view
        )
        self._model, self._plugin = assembly.forward_model, assembly.scene_plugin
        self._source = recipe.source or assembly.source
        self._order = clip_order(self._source)
        self._view, self._beside = recipe.view, assembly.simulated_field.surroundings(recipe.view)
        self._sensor = replace(assembly.sensor, full_scale=recipe.full_scale or 1.0)
        self._channels = self._sensor.channels(self._stack.channels)

    def exposure(self, split: str, index: int) -> tuple[Clip, NDArray[np.float32]]:
        """Return the part of a sample's clip that the shutter sees, and the noiseless exposure ``(C, H, W)`` it gives."""
        begin = time.perf_counter()
        with plugin_errors(self._plugin):
            clip = scene_clip(self._source, self._seed, split, index, self._order)
        self.scene_s = time.perf_counter() - begin
        shutter, rows = self._model.shutter, self._model.sensor_shape[0]
        if shutter is not None:
            check_clip(clip, shutter, rows, self._chosen.slivers)
            clip = exposed_part(clip, shutter, rows)
        clip = surrounded(clip, self._view, self._beside)
        return clip, self._model.forward_clip(clip)

    def sample(self, split: str, index: int) -> Sample:
        """Return one sample."""
        clip, exposure = self.exposure(split, index)
        noiseless = self._sensor.noiseless(exposure)
        measurement = self._sensor.expose(exposure, generator(self._seed, split, index, "noise"))
        metadata: dict[str, Any] = {
            "split": split,
            "index": index,
            "scene": clip.source,
            # One image of all frames' rows: the share is that of all values.
            "clipped_colour_share": clipped_share(
                clip.rgb.reshape(-1, *clip.rgb.shape[2:]), self._model.scene_to_camera
            ),
            "psf": self._stack.fingerprint,
            "full_scale": self._sensor.full_scale,
            **self._sensor.shares(exposure).record,
            "clamped_depth_share": clamped_share(clip.depth_m, clip.valid, self._stack.depths_m),
            "clamped_light_share": self._model.clamped_light(clip),
        }
        if self._sensor.stored_cfa is not None:
            metadata["cfa"] = self._sensor.stored_cfa
        noise = self._sensor.noise
        if isinstance(noise, GaussianNoise):
            metadata["noise_std"] = noise.standard_deviation(noiseless)
        frames = len(clip.rgb)
        slivers = self._chosen.slivers or frames
        if frames > 1:
            metadata |= {
                "frames_seen": frames,
                "slivers": slivers,
                "frame_durations_s": durations_s(clip.frame_edges_s),
            }
        truth = clip if self._chosen.ground_truth == "frames" else sliver_means(clip, slivers)
        measured = None
        if self._chosen.global_measurements:
            measured = np.empty((slivers, *noiseless.shape), np.float32)
            for n, seen in enumerate(self._model.global_measurements(clip, slivers)):
                measured[n] = self._sensor.noiseless(seen)
        return Sample(
            measurement,
            noiseless,
            truth.rgb,
            np.minimum(truth.depth_m, np.float32(FARTHEST_M)),
            truth.valid,
            self._seed,
            clip.label,
            self._channels,
            metadata,
            truth.extras,
            frame_edges_s=truth.frame_edges_s if frames > 1 else None,
            global_measurements=measured,
            surroundings=None if truth.surroundings is None else truth.surroundings.within(FARTHEST_M),
        )

    def stored(self, root: StorePath, split: str, index: int) -> SampleRecord | None:
        """Return the record of a sample that a writer left in a store when it died before it could list it; None without."""
        folder = sample_folder(root, split, index)
        if not (folder / DESCRIPTION).is_file():
            return None
        described, data = read_description(folder)
        made_with = described["seed"], described["metadata"].get("psf"), described["metadata"].get("full_scale")
        if made_with != (self._seed, self._stack.fingerprint, self._sensor.full_scale):
            return None  # writing it anew will say so
        digest = digest_of(described["files"] | {DESCRIPTION: sha256_bytes(data)})
        return SampleRecord(sample_id(index), split, digest, self._seed, described["label"])


def scene_clip(source: SceneSource, seed: int, split: str, index: int, order: ClipOrder | None = None) -> Clip:
    """Return the clip that a sample shows, drawn from the sample's own generator.

    Splits of a source with a length share no video (see `simulator.dataset.clips`). A source without end is asked for 0, 1,
    2 and so on in every split: what it takes in turn, such as its classes, comes in equal parts; the generator makes the
    splits differ.
    """
    order = order or clip_order(source)
    place = index if order is None else order.place(split, index)
    return source.clip(place, generator(seed, split, index, "scene"))


def check_first_clip(recipe: Recipe) -> None:
    """Look at a clip before there is a PSF stack.

    Raises:
        ClipTimesError: it does not suit the shutter.
    """
    plugin = Assembly(recipe.config).scene_plugin
    with plugin_errors(plugin):
        clip = scene_clip(recipe.source or Assembly(recipe.config).source, recipe.config.seed, "pilot", 0)
    check_clip(clip, recipe.shutter, recipe.config.camera.sensor.shape[0], recipe.config.dataset.slivers)


_maker: SampleMaker | None = None


def start_worker(recipe: Recipe) -> None:
    """Prepare this process to make samples.

    Raises:
        InputError: this machine has other versions of the packages that decide samples.
    """
    global _maker
    here = installed_versions(recipe.versions)
    if changed := [
        f"{name} {here[name]} (not {wanted})" for name, wanted in recipe.versions.items() if here[name] != wanted
    ]:
        raise InputError(
            "dataset.engine", f"a worker on {platform.node()} has {', '.join(changed)}; install the same on every node"
        )
    if recipe.backend != "none":
        from simulator.render.backend import activate

        activate(recipe.backend, threads=1)
    _maker = SampleMaker(recipe)


def make_pilot(task: tuple[Place, int]) -> Place:
    """Write the noiseless exposure of a pilot sample, which automatic exposure looks at; ``task`` is (folder, index).

    Returns:
        The file: what a cluster sends back must be small.
    """
    assert _maker is not None
    folder, index = task
    data = io.BytesIO()
    np.save(data, _maker.exposure("pilot", index)[1])
    path = folder / f"{index}.npy"
    write_atomic(path, data.getvalue())
    return path


@dataclass(frozen=True)
class Made:
    """What a worker says of a sample that it made.

    Attributes:
        record: what it is.
        stages: the seconds that each of `simulator.dataset.manifest.STAGES` took; none where it was there.
        cpu: level of the processor; None where it was there.
    """

    record: SampleRecord
    stages: tuple[float, ...] = ()
    cpu: str | None = None


def make_sample(task: tuple[Place, str, int]) -> Made:
    """Make and write one sample; ``task`` is (data set, split, index)."""
    assert _maker is not None
    root, split, index = task
    if isinstance(root, StorePath) and (record := _maker.stored(root, split, index)) is not None:
        return Made(record)
    begin = time.perf_counter()
    sample = _maker.sample(split, index)
    made = time.perf_counter()
    record = write_sample(root, split, index, sample)
    stages = _maker.scene_s, made - begin - _maker.scene_s, time.perf_counter() - made
    return Made(record, stages, _maker.cpu)


Task = TypeVar("Task")
Result = TypeVar("Result")


def perform(
    chosen: DatasetConfig,
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    count: int,
    recipe: Recipe | None = None,
) -> Iterator[Outcome[Task, Result]]:
    """Apply one of the functions above to ``count`` tasks on the engine that a configuration chose.

    ``recipe``: with which workers are prepared, for what needs that.
    """
    if not count:
        return
    workers: int | str = chosen.workers
    if chosen.engine == "local":
        workers = min(available_cpus() if workers == "auto" else int(workers), count)
    outcomes = run(
        chosen.engine,
        function,
        tasks,
        workers=workers,
        initializer=None if recipe is None else start_worker,
        initargs=() if recipe is None else (recipe,),
        timeout_s=chosen.timeout_s,
        ray=chosen.ray,
    )
    assert isinstance(outcomes, Generator)  # leaving it early stops the workers
    with closing(outcomes):
        yield from outcomes
