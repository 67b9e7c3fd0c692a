"""What a shutter is in words and numbers, and a test bench: the configured camera in front of spots that flash."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.assembly import Assembly
from simulator.camera.forward import ForwardModel
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, Shutter
from simulator.camera.slivers import frames_seen
from simulator.config.psf import ComputedPsf
from simulator.optics.stack import PsfStack
from simulator.types import Clip

_ORDERS = {"outside_in": "from the outside in", "centre_out": "from the centre out"}


def duration(seconds: float) -> str:
    """Return a time in the unit that suits it.

    Example:
        >>> duration(9.17e-6), duration(0.01), duration(1.5), duration(0)
        ('9.17 µs', '10 ms', '1.5 s', '0 ms')
    """
    if seconds and abs(seconds) < 1e-3:
        return f"{seconds * 1e6:.4g} µs"
    return f"{seconds * 1e3:.4g} ms" if seconds < 1 else f"{seconds:.4g} s"


def shutter_name(shutter: Shutter) -> str:
    """Return what kind of shutter it is."""
    if isinstance(shutter, GlobalShutter):
        return "global shutter"
    if isinstance(shutter, RollingShutter):
        return f"rolling shutter, {shutter.direction}"
    if isinstance(shutter, DualRollingShutter):
        return f"dual rolling shutter, {_ORDERS[shutter.order]}"
    return "row-by-row shutter"


def shutter_facts(
    shutter: Shutter,
    rows: int,
    scene: Mapping[str, Any],
    slivers: int | None = None,
    light: NDArray[np.floating] | None = None,
) -> list[tuple[str, str]]:
    """Return what is worth knowing of a shutter, as (what, value).

    Args:
        shutter: the shutter.
        rows: stored rows.
        scene: parameters of the scenes; ``frames`` and ``frames_per_second`` are compared with the shutter.
        slivers: how many are wanted; None is one per frame.
        light: where a point in the middle of the scene shines, ``(height, width)`` in pixels around the sensor's middle;
            None leaves out which rows see it.
    """
    facts = [("shutter", shutter_name(shutter)), ("exposure", _exposure(shutter, rows))]
    if isinstance(shutter, RollingShutter | DualRollingShutter):
        steps = "pair of rows" if isinstance(shutter, DualRollingShutter) else "row"
        facts.append(("line time", f"{duration(shutter.line_time_s)} per physical {steps}"))
    per_row = f", each the mean of {shutter.binning} physical rows" if shutter.binning > 1 else ""
    facts += [
        ("rows", f"{rows} in the image{per_row}"),
        ("capture", f"{duration(shutter.duration_s(rows))} until the last row closes; {_together(shutter, rows)}"),
        ("frames told apart", _separable(shutter, rows)),
    ]
    facts += _scene_facts(shutter, rows, scene, slivers)
    if light is not None and not isinstance(shutter, GlobalShutter):
        facts.append(("light from the middle", _middle(shutter, rows, light)))
    return facts


def _exposure(shutter: Shutter, rows: int) -> str:
    times = shutter.exposures_s(rows)
    if np.ptp(times) <= 1e-9 * times.max():
        return f"{duration(float(times[0]))} per row"
    least, mean, most = (duration(float(value)) for value in (times.min(), times.mean(), times.max()))
    return f"{least} to {most} per row, {mean} on average"


def _together(shutter: Shutter, rows: int) -> str:
    windows = shutter.windows_s(rows)
    opening, closing = float(windows[..., 0].max()), float(windows[..., 1].min())
    if opening < closing:
        return f"all rows are open from {duration(opening)} to {duration(closing)}"
    return "at no time are all rows open"


def _separable(shutter: Shutter, rows: int) -> str:
    count = shutter.separable_frames(rows)
    if isinstance(shutter, GlobalShutter):
        return "1: all rows see the same time, so that what moves only blurs"
    if count == 1:
        return "1: any two rows are open together for some time; shorter frames come apart only as far as rows differ"
    return f"{count}: so many rows are open one after another, no two together; shorter frames mix in every row"


def _middle(shutter: Shutter, rows: int, light: NDArray[np.floating]) -> str:
    """Return which rows a point in the middle of the scene shines on, all but 1 % of its light, and when they are open."""
    below = np.cumsum(light.sum(axis=1)) / light.sum()
    first, last = (int(np.searchsorted(below, share)) + (rows - len(below)) // 2 for share in (0.005, 0.995))
    lit = slice(max(0, first), min(rows, last + 1))
    windows = shutter.windows_s(rows)
    opening, closing = float(windows[lit, ..., 0].min()), float(windows[lit, ..., 1].max())
    which = "all" if lit == slice(0, rows) else f"{lit.stop - lit.start} of {rows}"
    seen = f"{which} rows see it, open from {duration(opening)} to {duration(closing)}"
    lost = {"before": opening > windows[..., 0].min(), "after": closing < windows[..., 1].max()}
    if not any(lost.values()):
        return seen
    when = " and ".join(word for word, is_lost in lost.items() if is_lost)
    return f"{seen}; what moves there {when} is not recorded: a larger mask reaches more rows"


def _slower(rate: float) -> str:
    """Return a frame rate rounded down, so that what is read off it lasts long enough."""
    scale = 10.0 ** (np.floor(np.log10(rate)) - 3)
    return f"{np.floor(rate / scale) * scale:.6g}"


def _scene_facts(shutter: Shutter, rows: int, scene: Mapping[str, Any], slivers: int | None) -> list[tuple[str, str]]:
    frames, rate = scene.get("frames"), scene.get("frames_per_second")
    if not isinstance(frames, int):
        return []
    if frames == 1:
        return [("scenes", "stand still (1 frame), as long as the shutter is open")]
    open_s = shutter.duration_s(rows)
    fastest = _slower(frames / open_s)
    if not isinstance(rate, int | float):
        return [
            ("scenes", f"{frames} frames at a rate of their own; at more than {fastest} per second they are too short")
        ]
    clips = f"{frames} frames at {rate:g} per second last {duration(frames / rate)}"
    seen = frames_seen(np.arange(int(np.ceil(open_s * rate)) + 2) / rate, shutter, rows)
    if seen.stop > frames:
        needs = f"too short, the shutter needs {seen.stop} frames, or at most {fastest} per second"
        return [("scenes", f"{clips}: {needs}")]
    which = "all" if seen == slice(0, frames) else f"frames {seen.start + 1} to {seen.stop}"
    return [("scenes", f"{clips}; the shutter sees {which}"), ("slivers", _slivers(seen.stop - seen.start, slivers))]


def _slivers(frames: int, slivers: int | None) -> str:
    even = f"{', '.join(str(number) for number in range(1, frames + 1) if frames % number == 0)} come out even"
    if slivers is None:
        return f"{frames}, one per frame seen; {even}"
    if slivers > frames or frames % slivers:
        return f"{slivers} of {frames} frames seen do not come out even; {even}"
    each = frames // slivers
    return f"{slivers} of {each} frame{'s' if each > 1 else ''} each; {even}"


Grey = NDArray[np.float32]
SAMPLES = 100
"""Time samples that a capture is thought of."""


@dataclass(frozen=True)
class Spot:
    """A white disc that shines during one time sample of the capture.

    Attributes:
        row: of its centre, share of the scene's height.
        column: of its centre, share of the scene's width.
        sample: number of the time sample, 1 to ``SAMPLES``.
        colour: linear RGB that stands for it in figures; its own light is white.
        name: of the colour.
    """

    row: float
    column: float
    sample: int
    colour: tuple[float, float, float]
    name: str


class Bench:
    """The configured camera, with its own PSFs and shutter, and the same with others in their place.

    All images are the mean of the channels, so that colours are free to tell times or depths apart; the camera's colours
    and noise are left out.
    """

    def __init__(self, assembly: Assembly) -> None:
        """Compute the nearest and the farthest PSF of the assembly (cached), or read them."""
        config, self.shutter = assembly.config, assembly.shutter
        self.scene_shape, self.sensor_shape = config.scene.size, config.camera.sensor.shape
        self.rows = self.sensor_shape[0]
        self.duration_s = self.shutter.duration_s(self.rows)
        self._boundary = config.forward.boundary
        self._irradiance = assembly.simulated_field.of_view.irradiance(assembly.view)
        self.ends = _ends(assembly)
        values = np.asarray(self.ends.values)
        far = replace(self.ends, values=values[-1:], depths_m=self.ends.depths_m[-1:])
        lens = replace(far, values=np.ones_like(values[-1:, :, :1, :1]))
        everything = GlobalShutter(self.duration_s, self.shutter.binning)
        self._instant = self._model(far, None)
        self._shuttered = self._model(far, self.shutter)
        self._global = self._model(far, everything)
        self._lens, self._lens_always = self._model(lens, self.shutter), self._model(lens, everything)
        self._depths = self._model(self.ends, self.shutter)

    @property
    def is_global(self) -> bool:
        """Whether all rows are open at the same time."""
        windows = self.shutter.windows_s(self.rows)
        return bool(np.ptp(windows[..., 0]) == 0 and np.ptp(windows[..., 1]) == 0)

    def time_s(self, sample: int) -> float:
        """Return the middle of a time sample, seconds after the first row opens."""
        return (sample - 0.5) / SAMPLES * self.duration_s

    def scene(self, spot: Spot) -> Grey:
        """Return a spot in the scene, ``(h, w)`` from 0 to 1."""
        height, width = self.scene_shape
        radius = max(1.0, 0.015 * min(height, width))
        rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
        away = np.hypot(rows - spot.row * (height - 1), columns - spot.column * (width - 1))
        return np.clip(radius + 0.5 - away, 0, 1).astype(np.float32)

    def convolved(self, spot: Spot) -> Grey:
        """Return the irradiance of a spot on the sensor, ``(H, W)``, whatever the shutter does."""
        return _grey(self._instant.forward_clip(self._still(self.scene(spot), self.ends.depths_m[-1])))

    def share(self, spot: Spot) -> Grey:
        """Return the share of the spot's time sample during which each row of the stored image is open, ``(H,)``."""
        weights = self.shutter.weights(self.rows, self._flash(spot).frame_edges_s)
        return weights[self._lit(spot), ::-1].astype(np.float32)

    def exposed(self, spot: Spot) -> Grey:
        """Return what the shutter lets through of a spot, ``(H, W)``, divided by the time sample: 1 x where always open."""
        return self._per_sample(self._shuttered, spot)

    def exposed_globally(self, spot: Spot) -> Grey:
        """Return the same under a global shutter that is open for all of the capture."""
        return self._per_sample(self._global, spot)

    def exposed_behind_lens(self, spot: Spot, *, always: bool = False) -> Grey:
        """Return the same of a lens in the mask's place: the part of the sensor that holds its image, ``(h, w)``.

        Args:
            spot: the spot.
            always: under a global shutter that is open for all of the capture.
        """
        image = self._per_sample(self._lens_always if always else self._lens, spot)
        top, left = ((a - b) // 2 for a, b in zip(self.sensor_shape, self.scene_shape, strict=True))
        return image[top : top + self.scene_shape[0], left : left + self.scene_shape[1]]

    def point(self, row: float, column: float, depth_m: float) -> Grey:
        """Return the exposure of a lasting point at a depth, ``(H, W)``, under the shutter."""
        scene = np.zeros(self.scene_shape, np.float32)
        scene[round(row * (self.scene_shape[0] - 1)), round(column * (self.scene_shape[1] - 1))] = 1
        return _grey(self._depths.forward_clip(self._still(scene, depth_m)))

    def _per_sample(self, model: ForwardModel, spot: Spot) -> Grey:
        return _grey(model.forward_clip(self._flash(spot))) / np.float32(self.duration_s / SAMPLES)

    def _model(self, stack: PsfStack, shutter: Shutter | None) -> ForwardModel:
        return ForwardModel(
            stack,
            self.sensor_shape,
            self.scene_shape,
            shutter,
            self._boundary,
            irradiance=self._irradiance,
            scene_to_camera=np.full((len(stack.channels), 3), 1 / 3),
        )

    def _still(self, scene: Grey, depth_m: float) -> Clip:
        return self._clip(scene[None], depth_m, np.array([0.0, self.duration_s]))

    def _flash(self, spot: Spot) -> Clip:
        """Return a clip that is dark, but for the spot's time sample."""
        edges = np.array([0, spot.sample - 1, spot.sample, SAMPLES]) / SAMPLES * self.duration_s
        frames = np.zeros((3, *self.scene_shape), np.float32)
        frames[1] = self.scene(spot)
        kept = np.diff(edges) > 0
        return self._clip(frames[kept], self.ends.depths_m[-1], np.unique(edges))

    def _lit(self, spot: Spot) -> int:
        return 0 if spot.sample == 1 else 1

    def _clip(self, frames: Grey, depth_m: float, frame_edges_s: NDArray[np.float64]) -> Clip:
        depth = np.full(frames.shape, depth_m, np.float32)
        rgb = np.repeat(frames[..., None], 3, axis=-1)
        return Clip(rgb, depth, np.ones(frames.shape, bool), frame_edges_s)


def _ends(assembly: Assembly) -> PsfStack:
    """Return the stack of the nearest and the farthest depth, or of the only one."""
    config = assembly.config
    if isinstance(config.psf, ComputedPsf):
        depths_m = assembly.depths_m
        ends_cm = tuple(dict.fromkeys(depth * 1e2 for depth in (depths_m[0], depths_m[-1])))
        config = config.model_copy(update={"psf": config.psf.model_copy(update={"depths_cm": ends_cm})})
        return replace(assembly, config=config).psf_stack
    stack = assembly.psf_stack
    ends = sorted({0, len(stack.depths_m) - 1})
    return replace(stack, values=np.asarray(stack.values)[ends], depths_m=stack.depths_m[ends])


def _grey(image: NDArray[np.float32]) -> Grey:
    """Return the channels' mean; rounding of the convolution leaves tiny negative values, which no sensor has."""
    return np.clip(image.mean(axis=0), 0, None)
