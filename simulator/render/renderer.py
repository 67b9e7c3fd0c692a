"""Scenes become clips: stills and frame sequences, by path tracing, with what else is known of each pixel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import activate, mitsuba
from simulator.render.bands import check_edges, split_film
from simulator.render.denoise import check_denoiser, denoise, denoiser_name, guides
from simulator.render.frames import Frame, check_outputs, dim_fireflies_in, join_frames, repair
from simulator.render.gbuffer import GBuffer, centre_depth, centre_gbuffer, motion_vectors, moved_points, seen_points
from simulator.render.hidden import hidden_layers
from simulator.render.mitsuba_scene import SURROUNDINGS, Stage
from simulator.render.own_scene import OwnScene, load_own_scene
from simulator.render.scene import Scene
from simulator.types import Clip, View

# Light paths of camera - surface - ... - light: enough for light to fill the shadows of a crowded scene.
DEFAULT_MAX_DEPTH = 5


@dataclass(frozen=True)
class Renderer:
    """How scenes are rendered; small, picklable, and handed to every scene family.

    Attributes:
        backend: the Mitsuba variant, see `simulator.render.choose_backend`.
        outputs: what clips hold in ``extras`` beside colour and depth, see `simulator.render.frames.OUTPUTS`.
        hidden: how many layers behind the image the output ``hidden`` holds.
        max_depth: longest light path, in segments.
        denoise: whether the image passes a trained denoiser: less noise, but biased (see `simulator.render.denoise`). The
            clip's ``source`` says so; hidden layers are left as they are.

        bands_nm: edges of wavelength bands in nanometres, none or at least two: clips then hold ``bands`` in ``extras``,
            float32 ``(T, H, W, N)``, mean spectral radiance of each band in the scale of `simulator.render.bands`.

    Raises:
        InputError: when ``outputs`` names something else, the denoiser is not installed, or bands are asked for of a variant
            that is not spectral, or together with what does not know them.
    """

    backend: str
    outputs: tuple[str, ...] = ()
    hidden: int = 1
    max_depth: int = DEFAULT_MAX_DEPTH
    denoise: bool = False
    bands_nm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_outputs(self.outputs)
        if self.hidden < 1:
            raise InputError("render.hidden_layers", f"got {self.hidden}, expected at least 1")
        if self.denoise:
            check_denoiser()
        if self.bands_nm:
            self._check_bands()

    def _check_bands(self) -> None:
        check_edges(self.bands_nm)
        if not self.backend.endswith("_spectral"):
            raise InputError(
                "render.bands", f"got the variant {self.backend}, expected a spectral one (see choose_backend)"
            )
        for name, wanted in (("render.denoise", self.denoise), ("render.outputs", "hidden" in self.outputs)):
            if wanted:
                raise InputError(name, "cannot be combined with render.bands; leave one of them out")

    def still(self, scene: Scene, view: View, *, samples_per_pixel: int, seed: int, source: dict[str, Any]) -> Clip:
        """Render one image: a clip of a single frame that lasts from 0 to 1 s; arguments and errors as in `clip`."""
        named: dict[str, Any] = {"samples_per_pixel": samples_per_pixel, "seed": seed, "source": source}
        return self.clip([scene], view, frames_per_second=1, **named)

    def clip(
        self,
        frames: Iterable[Scene],
        view: View,
        *,
        frames_per_second: float,
        samples_per_pixel: int,
        seed: int,
        source: dict[str, Any],
        label: str | None = None,
        dim_fireflies: bool = False,
    ) -> Clip:
        """Render scenes through the pinhole of a view: linear RGB by path tracing, depth by centre rays.

        The same arguments give the same bytes, whatever the scenes rendered before. So does any number of threads, but for
        LLVM with more paths per pixel than a register holds: where threads meet, last digits of a pixel's sum may differ.

        Args:
            frames: the scene in the middle of each frame, all with the same slots; what does not move should be the same
                object from frame to frame. They may be made lazily.
            view: image shape, pinhole geometry and depth range; beside the image, in its margin, light is rendered in coarse
                pixels with a quarter of the paths, or 4.
            frames_per_second: frame t lasts from ``t / frames_per_second`` to ``(t + 1) / frames_per_second``.
            samples_per_pixel: light paths per pixel, at least 1; a number that is not close to a x b with a and b near its
                root is rounded up (7 to 8), and what was used is recorded.
            seed: of the path tracer, 0 <= seed < 2**32; draw it from the sample's generator. Each frame has noise of its own.
            source: where the scene came from, JSON-serialisable; seed, samples, variant and the number of repaired pixels
                are added to it.
            label: class name of an action, or None.
            dim_fireflies: for wet scenes with small lamps, whose lone glaring pixels are noise that more paths hardly mend:
                see `simulator.render.frames.firefly_dimming`. Their share and that of the light they lose is added to
                ``source``.

        Returns:
            The clip. Where no surface is seen ``valid`` is false and the depth is the view's far depth (`FARTHEST_M` if
            that is infinite: a depth is never inf).

        Raises:
            InputError: when the samples, the seed or the frame rate are out of range, there is no frame, frames have
                different slots, or motion is asked for of a still.
            RuntimeError: when more than 0.1 % of a frame's pixels are not finite.
        """
        _check_numbers(samples_per_pixel, seed, frames_per_second)
        activate(self.backend)
        taken = list(self._trace(iter(frames), view, samples_per_pixel, seed))
        if not taken:
            raise InputError("frames", "got none, expected at least one scene")
        if "motion" in self.outputs and len(taken) == 1:
            raise InputError(
                "render.outputs", "motion needs clips of at least 2 frames, and this scene is a still; leave it out"
            )
        if dim_fireflies:
            source = source | dim_fireflies_in(taken)
        return join_frames(taken, view, frames_per_second, source | self._facts(seed), label)

    def own_still(
        self,
        path: Path,
        view: View,
        *,
        metres_per_unit: float | None,
        samples_per_pixel: int,
        seed: int,
        source: dict[str, Any],
    ) -> Clip:
        """Render a user's own Mitsuba scene from where its camera stands, through the pinhole of a view: one frame of 1 s.

        One unit of the scene stands for ``metres_per_unit``; None scales it about its camera into the depth range. The scale
        and the shapes' own names are added to ``source``; the other arguments are those of `clip`.

        Raises:
            InputError: as `clip`, and for all that `simulator.render.own_scene` refuses.
        """
        _check_numbers(samples_per_pixel, seed, 1)
        if self.bands_nm:
            raise InputError(
                "render.bands", f"a Mitsuba scene from a file, {path}, is rendered in RGB only; leave them out"
            )
        for name in ("motion", "hidden"):
            if name in self.outputs:
                raise InputError(
                    "render.outputs", f"{name} is not available for a Mitsuba scene from a file, {path}; leave it out"
                )
        activate(self.backend)
        own = load_own_scene(path, view, self.max_depth)
        hits, scale = own.look(view, metres_per_unit)
        frame = self._frame(own, samples_per_pixel, seed)
        if not frame.rgb.any():
            raise InputError(
                path, "renders black: none of its lights reaches what its camera sees; check their radiance and place"
            )
        frame.depth_m, frame.hits = hits.depth_m, hits
        if view.margin != (0, 0):
            frame.around = self._light_around(own, samples_per_pixel, seed), own.depth_beside(scale)
        facts = source | {"metres_per_unit": scale, "shape_names": list(own.shape_ids)}
        return join_frames([frame], view, 1, facts | self._facts(seed), None)

    def _facts(self, seed: int) -> dict[str, Any]:
        facts: dict[str, Any] = {"render_seed": seed, "variant": self.backend}
        if self.denoise:
            facts["denoised"] = denoiser_name()
        if self.bands_nm:
            facts["band_edges_nm"] = list(self.bands_nm)
        return facts

    def _trace(self, frames: Iterator[Scene], view: View, samples_per_pixel: int, seed: int) -> Iterator[Frame]:
        """Yield the frames one by one; on return no Mitsuba object is left, else the next clip would recompile."""
        stage: Stage | None = None
        before: tuple[GBuffer, Scene] | None = None
        frame_seed = seed
        for number, scene in enumerate(frames):
            if stage is None:
                stage = Stage(scene, view, self.max_depth, self.bands_nm)
            else:
                stage.show(scene)
            if number:  # the first frame's noise is that of a still with the same seed; the others' are unrelated to it
                frame_seed = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
            frame = self._frame(stage, samples_per_pixel, frame_seed)
            if view.margin != (0, 0):
                depth_m = centre_depth(stage.loaded, SURROUNDINGS)
                frame.around = self._light_around(stage, samples_per_pixel, frame_seed), depth_m
            if before is not None and "motion" in self.outputs:
                points = moved_points(before[0], before[1], scene)
                frame.came_from = (motion_vectors(points, before[0], view), seen_points(stage.loaded, points, view))
            if frame.hits is not None:
                before = (frame.hits, scene)
            yield frame

    def _frame(self, stage: Stage | OwnScene, samples_per_pixel: int, seed: int) -> Frame:
        mi = mitsuba()
        loaded = stage.loaded
        image = mi.render(loaded, spp=samples_per_pixel, seed=seed)
        film = np.array(image, dtype=np.float32)
        if self.bands_nm:
            film = np.concatenate(split_film(film), axis=-1)
        film, repaired = repair(film)
        rgb, bands = film[..., :3], film[..., 3:] if self.bands_nm else None
        samples = int(loaded.sensors()[0].sampler().sample_count())
        if self.denoise:
            rgb = denoise(rgb, *guides(loaded, seed))
        hits = centre_gbuffer(loaded) if self.outputs else None
        depth = centre_depth(loaded) if hits is None else hits.depth_m
        layers = []
        if "hidden" in self.outputs:
            assert isinstance(stage, Stage)
            layers = hidden_layers(
                loaded, stage.scene, self.hidden, samples=samples, seed=seed, max_depth=self.max_depth
            )
        return Frame(rgb, depth, samples, repaired, self.outputs, hits, layers, bands)

    def _light_around(self, stage: Stage | OwnScene, samples_per_pixel: int, seed: int) -> NDArray[np.float32]:
        """Return the light of the whole field in coarse pixels, with noise that is unrelated to the image's."""
        samples = max(-(-samples_per_pixel // 4), min(samples_per_pixel, 4))
        other = int(np.random.SeedSequence(seed, spawn_key=(SURROUNDINGS,)).generate_state(1)[0])
        film = np.array(mitsuba().render(stage.loaded, sensor=SURROUNDINGS, spp=samples, seed=other), np.float32)
        if self.bands_nm:
            film = split_film(film)[0]
        return repair(film)[0]


def _check_numbers(samples_per_pixel: int, seed: int, frames_per_second: float) -> None:
    if samples_per_pixel < 1:
        raise InputError("samples_per_pixel", f"got {samples_per_pixel}, expected at least 1")
    if not 0 <= seed < 2**32:
        raise InputError("seed", f"got {seed}, expected 0 <= seed < 2**32")
    if not 0 < frames_per_second < np.inf:
        raise InputError("frames_per_second", f"got {frames_per_second}, expected a positive number")
