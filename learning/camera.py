"""What a reconstruction knows of the camera: its PSFs, and how stored numbers follow from the radiance of a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from learning.timing import Timing, recorded_timing
from simulator.arrays import Array, like, namespace, to_numpy
from simulator.assembly import Assembly
from simulator.camera.convolution import StackConvolution
from simulator.camera.field import FieldOfView, field_from_record
from simulator.camera.forward import ForwardModel
from simulator.camera.sensor import Sensor
from simulator.config import Config, config_from_dict
from simulator.config.camera import ExposureConfig
from simulator.dataset.dataset_info import FILE, DatasetInfo
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack
from simulator.text import show
from simulator.types import View

_WHITE_PERCENTILE, _WHITE_SAMPLES = 99.0, 64


@dataclass(frozen=True, eq=False)
class CaptureModel:
    """How a scene became a measurement: ``y = offset + gain exposure sum_n share_n sum_k H_k (*) (irradiance M L_nk)``.

    A still is a clip of one frame, whose share of every row's exposure is 1.

    Attributes:
        stack: the assumed PSFs H, K depths and C channels; not always those of the simulation.
        sensor_shape: H, W of the measurement.
        scene_shape: h, w of the image; pixels lie on pixels, the centres coincide.
        gain: DN / 2^bits per unit of exposed irradiance x PSF.
        offset: DN / 2^bits without light, ``(C,)``.
        irradiance: at the mask per unit radiance (see `simulator.camera.field.FieldOfView`), of the whole field from which
            light comes: the image, and around it the margin that was simulated, with the same middle.
        scene_to_camera: M, ``(C, 3)``, from linear sRGB to the camera's channels.
        white: reference white, the radiance that images show as 1: one number for training, tests and every method.
        timing: the frames of a clip and when rows see them; None of stills.
        row_exposure: exposure of each stored row over that of the gain, ``(H,)``; None where all rows have the same exposure.

    Raises:
        InputError: shapes that contradict each other, or numbers that make no sense.
    """

    stack: PsfStack
    sensor_shape: tuple[int, int]
    scene_shape: tuple[int, int]
    gain: float
    offset: NDArray[np.float64]
    irradiance: NDArray[np.float32]
    scene_to_camera: NDArray[np.float64]
    white: float = 1.0
    timing: Timing | None = None
    row_exposure: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        channels = len(self.stack.channels)
        rows = self.sensor_shape[0]
        for name, shape, wanted in (
            ("offset", self.offset.shape, (channels,)),
            ("scene_to_camera", self.scene_to_camera.shape, (channels, 3)),
            ("row_exposure", (rows,) if self.row_exposure is None else self.row_exposure.shape, (rows,)),
        ):
            if tuple(shape) != tuple(wanted):
                raise InputError(
                    name, f"got shape {tuple(shape)}, expected {tuple(wanted)} for this stack and scene_shape"
                )
        sides = zip(("rows", "columns"), self.sensor_shape, self.scene_shape, self.field_shape, strict=True)
        for axis, sensor, scene, field in sides:
            for name, large, small in (("scene_shape", sensor, scene), ("irradiance", field, scene)):
                if small > large or (large - small) % 2:
                    got = f"got {scene} {axis} on a sensor of {sensor}, in a field of {field}"
                    raise InputError(name, f"{got}; expected at most as many, all even or all odd")
        for name, value in (("gain", self.gain), ("white", self.white)):
            if not (np.isfinite(value) and value > 0):
                raise InputError(name, f"got {value!r}, expected a positive number")

    @property
    def frames(self) -> int:
        """How many frames a capture holds; 1 of a still."""
        return 1 if self.timing is None else self.timing.frames

    @property
    def row_shares(self) -> NDArray[np.float64]:
        """Which share of each stored row's exposure each frame has, ``(N, H)``; 1 of a still."""
        rows = self.sensor_shape[0]
        return np.ones((1, rows)) if self.timing is None else self.timing.row_shares(rows)

    @property
    def row_weights(self) -> NDArray[np.float64]:
        """What each frame's irradiance counts for in each stored row, ``(N, H)``; 1 in all of them of a usual still."""
        return self.row_shares if self.row_exposure is None else self.row_shares * self.row_exposure

    @property
    def field_shape(self) -> tuple[int, int]:
        """Rows and columns of the field from which light comes, the image included."""
        rows, columns = self.irradiance.shape
        return rows, columns

    @property
    def scene_irradiance(self) -> NDArray[np.float32]:
        """`irradiance` of the image alone, ``(h, w)``."""
        return self.irradiance[self.scene_in_field]

    @property
    def scene_in_field(self) -> tuple[slice, slice]:
        """Where the image lies in the field."""
        return _middle(self.field_shape, self.scene_shape)

    def middle(self, shape: tuple[int, int]) -> tuple[EllipsisType, slice, slice]:
        """Return where a smaller image lies in this one, whose last axes are rows and columns."""
        return (..., *_middle(self.scene_shape, shape))

    @property
    def near_m(self) -> float:
        """Depth of the stack's nearest plane, metres."""
        return float(self.stack.depths_m[0])

    @property
    def far_m(self) -> float:
        """Depth of the stack's farthest plane, metres; may be ``inf``."""
        return float(self.stack.depths_m[-1])

    def disparity(self, depth_m: Array) -> Array:
        """Return disparity on the scale 0 (far) to 1 (near), evenly in 1 / z; depths outside the range are clamped."""
        return namespace(depth_m).clip((1 / depth_m - 1 / self.far_m) / self._range_per_m, 0, 1)

    def depth_m(self, disparity: Array) -> Array:
        """Return the depth in metres of disparities, which are clamped to 0..1 first."""
        clamped = namespace(disparity).clip(disparity, 0, 1)
        return 1 / (1 / self.far_m + clamped * self._range_per_m)

    def plane_disparities(self) -> NDArray[np.float64]:
        """Return the disparity of each of the stack's planes, ``(K,)``."""
        return self.disparity(np.asarray(self.stack.depths_m, np.float64))

    def to_srgb(self, light: Array) -> Array:
        """Return linear sRGB ``(..., 3, h, w)`` of light in the camera's channels ``(..., C, h, w)``, in the same unit.

        The inverse of `scene_to_camera`; for other than three channels in the sense of least squares.
        """
        inverse = like(np.linalg.pinv(self.scene_to_camera), light)
        return namespace(light).einsum("ac,...chw->...ahw", inverse, light)

    def forward_model(self, reference: Array | None = None) -> ForwardModel:
        """Return the convolution: ``offset + gain forward(V)`` is the measurement of a still's irradiance V over the field.

        V, ``(1, K, C, rows, columns)``, is irradiance at the mask in the camera's channels, ``irradiance M L_k``; the result
        lacks gain and offset, and of clips time: see `space_time`.
        ``reference`` is an array of the kind, type and device to work on; None is NumPy in float32.
        """
        stack = self.stack if reference is None else replace(self.stack, values=like(self.stack.values, reference))
        return ForwardModel(stack, self.sensor_shape, self.field_shape)

    def space_time(self, reference: Array) -> SpaceTime:
        """Return the same for clips, which `row_weights` expose; ``reference`` as for `forward_model`."""
        values = like(self.stack.values, reference)
        return SpaceTime(StackConvolution(values, self.sensor_shape, self.field_shape), self.row_weights)

    def with_stack(self, stack: PsfStack) -> CaptureModel:
        """Return the same camera assumed to have other PSFs; an InputError refuses other channels or another pixel pitch."""
        alike = np.isclose(stack.pixel_pitch_m, self.stack.pixel_pitch_m, rtol=1e-3, atol=0)
        if stack.channels != self.stack.channels or not alike:
            got, wanted = (f"{each.channels} at {each.pixel_pitch_m * 1e6:g} um" for each in (stack, self.stack))
            raise InputError("stack", f"got channels {got}, expected {wanted}: it belongs to another camera")
        return replace(self, stack=stack)

    def with_planes(self, count: int) -> CaptureModel:
        """Return the same camera with so many of its planes: both ends, and what is nearest to even steps of disparity.

        Fewer where one plane is the nearest to several steps. An InputError refuses fewer than two, or more than there are.
        """
        stack = self.stack
        if not 2 <= count <= len(stack.depths_m):
            raise InputError("planes", f"got {count}, expected 2 to {len(stack.depths_m)}, as many as the stack has")
        apart = np.abs(np.linspace(1, 0, count)[:, None] - self.plane_disparities())
        kept = np.unique(apart.argmin(axis=1))
        name = f"{stack.fingerprint}, planes {kept.tolist()}"
        return replace(
            self, stack=replace(stack, values=stack.values[kept], depths_m=stack.depths_m[kept], fingerprint=name)
        )

    def with_border(self, pixels: int) -> CaptureModel:
        """Return the same camera with an image larger by this many pixels on each side, or by as many as have light.

        It ends at the field, the sensor or a stop: the least irradiance of the border is at least half of the image's,
        because dividing by less would amplify noise. What lies farther out is dropped.
        """
        sides = list(zip(self.scene_shape, self.field_shape, self.sensor_shape, strict=True))
        least = self.scene_irradiance.min() / 2
        for border in range(pixels, -1, -1):  # no border at all is light enough
            rows, columns = (min(scene + 2 * border, field, sensor) for scene, field, sensor in sides)
            irradiance = self.irradiance[_middle(self.field_shape, (rows, columns))]
            if irradiance.min() >= least:
                break
        return replace(self, scene_shape=(rows, columns), irradiance=irradiance)

    def with_assumed(self, known: CaptureModel) -> CaptureModel:
        """Return the camera that made this data with the PSFs of ``known``, for which a method was trained or tuned.

        The camera's numbers (gain, offset, irradiance, colours) stay this data set's; PSFs, depth range and white are the
        known ones.

        Raises:
            InputError: other shapes, channels, pixel pitch or times, or scenes here beyond the depths that are known.
        """
        if (self.timing is None) != (known.timing is None):
            kinds = {True: "stills", False: "clips"}
            here, there = (kinds[each.timing is None] for each in (self, known))
            raise InputError("scene.frames", f"got {here}, the method is for {there}; take a method for {here}")
        if self.timing is not None and known.timing is not None:
            self.timing.check_same(known.timing, self.sensor_shape[0])
        for name in ("sensor_shape", "scene_shape"):
            here, there = getattr(self, name), getattr(known, name)
            if tuple(here) != tuple(there):
                wanted = f"{there[0]} x {there[1]}, for which the method was made; train and tune anew"
                raise InputError(name, f"got {here[0]} x {here[1]} pixels, expected {wanted}")
        # Of a single plane nothing follows for the range. A share of 1e-3 forgives depths that were written with few digits.
        excess = max(1 / self.near_m - 1 / known.near_m, 1 / known.far_m - 1 / self.far_m)
        if len(known.stack.depths_m) > 1 and excess > 1e-3 * known._range_per_m:
            here, there = (f"{each.near_m:g} to {each.far_m:g} m" for each in (self, known))
            cure = "give data within that range, or train and tune anew"
            raise InputError("stack", f"the data's depths are {here}, the method knows {there}; {cure}")
        return replace(self.with_stack(known.stack), white=known.white)

    @property
    def _range_per_m(self) -> float:
        span = 1 / self.near_m - 1 / self.far_m
        return span if span > 0 else 1.0  # of a single plane: all depths are one


class SpaceTime:
    """The linear map from frames to what the rows of the sensor saw of them, and its transpose."""

    def __init__(self, convolution: StackConvolution, row_weights: NDArray[np.float64]) -> None:
        self._convolution, self._weights = convolution, row_weights

    def forward(self, volume: Array) -> Array:
        """Return the light ``(..., C, H, W)`` of volumes ``(N, K, ..., C, rows, columns)`` of mask irradiance."""
        return self._convolution.forward_rows(volume, self._weights)

    def adjoint(self, light: Array) -> Array:
        """Return volumes of light: the transpose of ``forward``."""
        return self._convolution.adjoint_rows(light, self._weights)


def _middle(whole: tuple[int, int], part: tuple[int, int]) -> tuple[slice, slice]:
    first, second = (slice((many - few) // 2, (many + few) // 2) for many, few in zip(whole, part, strict=True))
    return first, second


def capture_model(dataset: Dataset, stack: str | Path | PsfStack = "nominal", *, white: float = 1.0) -> CaptureModel:
    """Return what is known of the camera that made a data set; no code that the data set names is run.

    ``stack`` is ``nominal``, the PSFs that made the data; ``captured``, as a calibration would have measured them
    (``psf.as_captured``); the folder of any other stack, or the stack itself. ``white`` see `measure_reference_white`.

    Raises:
        InputError: a mosaic's measurement, a circular convolution, a damaged record, no such stack, or one that does not fit;
            of clips no sample from which to tell the times.
    """
    info = dataset.info
    try:
        config = config_from_dict(info.config, dataset.root, check_plugins=False)
    except InputError as error:
        first, *more = str(error).splitlines()
        others = f" (and {len(more)} more)" if more else ""
        raise InputError(dataset.root / FILE, f"config.{first[:300]}{others}; restore it from a copy") from error
    if config.forward.boundary != "linear":
        reason = f"got forward.boundary {config.forward.boundary}, expected linear: light that misses a sensor is lost"
        raise InputError(dataset.root, reason)
    nominal = read_psf_stack(dataset.root / PSF_FOLDER)
    if tuple(info.channels) != nominal.channels:
        got = f"channels: got {show(list(info.channels))}, the PSFs have {show(list(nominal.channels))}"
        raise InputError(dataset.root / FILE, f"{got}; take camera.sensor.readout: binned_rgb")
    sensor = recorded_sensor(info, config)
    gain, offset, row_exposure = sensor_response(sensor, len(nominal.channels), mean=config.forward.time == "mean")
    near_m, far_m = nominal.depths_m[[0, -1]].tolist()
    mask_to_sensor_m = Assembly(config).mask_to_sensor_m
    view = View(info.scene_shape, sensor.binned_pitch_m, mask_to_sensor_m, near_m, far_m, margin=_recorded_margin(info))
    try:
        model = CaptureModel(
            stack=nominal,
            sensor_shape=info.sensor_shape,
            scene_shape=info.scene_shape,
            gain=gain,
            offset=offset,
            irradiance=_recorded_field(info, config).irradiance(view.field),
            scene_to_camera=info.colour_matrix,
            white=white,
            timing=recorded_timing(dataset),
            row_exposure=row_exposure,
        )
    except InputError as error:
        raise InputError(dataset.root / FILE, f"{error}; restore it from a copy") from error
    if isinstance(stack, PsfStack):
        return model.with_stack(stack)
    if stack == "nominal":
        return model
    folder = dataset.root / CAPTURED_FOLDER if stack == "captured" else Path(stack)
    if stack == "captured" and not folder.is_dir():
        raise InputError("stack", f"got captured, but {dataset.root} has no {CAPTURED_FOLDER}; set psf.as_captured")
    return model.with_stack(read_psf_stack(folder))


def camera_identity(capture: CaptureModel) -> str:
    """Return a hash of all that a camera model holds."""
    arrays = (capture.stack.values, capture.stack.depths_m, capture.irradiance, capture.offset, capture.scene_to_camera)
    parts = [sha256_bytes(np.ascontiguousarray(to_numpy(array)).tobytes()) for array in arrays]
    numbers = (capture.stack.pixel_pitch_m, capture.gain, capture.white, *capture.sensor_shape, *capture.scene_shape)
    of_clips = [] if capture.timing is None else [capture.timing.record()]
    of_rows = [] if capture.row_exposure is None else [capture.row_exposure.tolist()]
    return sha256_bytes(canonical_json([parts, numbers, capture.stack.channels, *of_clips, *of_rows]))


def check_range(capture: CaptureModel) -> None:
    """Refuse PSFs up to infinity where depth errors are in centimetres: a single pixel there would outweigh all others."""
    if len(capture.stack.depths_m) > 1 and not np.isfinite(capture.far_m):
        cure = "make the data set, or data.stack, with a finite one, such as 1000"
        raise InputError("psf.far_cm", f"got PSFs up to infinity, where an error has no length in centimetres; {cure}")


def check_lit(capture: CaptureModel) -> None:
    """Refuse an image of which parts send no light to the sensor: methods divide by its irradiance."""
    irradiance = capture.scene_irradiance
    if dark := irradiance.size - np.count_nonzero(irradiance > 0):
        got = f"got 0 at {dark} of the image's {irradiance.size} pixels, expected light from each"
        raise InputError("irradiance", f"{got}: nothing can be known of the others; take a smaller scene.size")


def check_one_plane(capture: CaptureModel, name: str) -> None:
    """Raise an InputError where the stack of a camera has several planes, but what is called ``name`` knows one."""
    planes = len(capture.stack.depths_m)
    if planes != 1:
        cure = "take data made with a single depth in psf.depths_cm, or such PSFs for these data (--stack)"
        raise InputError("stack", f"got {planes} planes, but {name} knows one: {cure}")


def _recorded_field(info: DatasetInfo, config: Config) -> FieldOfView:
    """Return how much of the light from each direction counts, from the record: the file of a response may be gone."""
    return field_from_record(info.field_of_view) if info.field_of_view else FieldOfView(config.forward.vignetting)


def _recorded_margin(info: DatasetInfo) -> tuple[int, int]:
    margin = info.field_of_view.get("margin", [0, 0])
    if not (isinstance(margin, list) and len(margin) == 2 and all(type(size) is int and size >= 0 for size in margin)):
        raise InputError("field_of_view.margin", f"got {show(margin)}, expected two numbers of pixels")
    return margin[0], margin[1]


def recorded_sensor(info: DatasetInfo, config: Config) -> Sensor:
    """Return the sensor of a data set from what the data set recorded, wherever the files are that its configuration names.

    Raises:
        InputError: a damaged record.
    """
    try:
        full_scale = float(info.exposure["full_scale"])
        responsivity = info.exposure.get("responsivity")
        if responsivity is not None:
            responsivity = tuple(float(responsivity[channel]) for channel in info.channels)
        if not all(0 < number < np.inf for number in responsivity or ()):
            msg = "not positive"
            raise ValueError(msg)
        # Without the illuminance: what it decides is recorded, and its files of spectra may be elsewhere.
        exposure = ExposureConfig(full_scale=full_scale)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        found = {name: show(info.exposure.get(name)) for name in ("full_scale", "responsivity")}
        reason = f"exposure: damaged, got {', '.join(f'{name} {text}' for name, text in found.items())}"
        raise InputError(config.base_dir / FILE, f"{reason}; restore it from a copy") from error
    camera = config.camera.model_copy(update={"exposure": exposure})
    recorded = Assembly(config.model_copy(update={"camera": camera}))
    if info.shutter is not None:
        recorded = recorded.having(shutter=info.shutter)
    return replace(recorded.sensor, full_scale=full_scale, responsivity=responsivity)


def sensor_response(
    sensor: Sensor, channels: int, *, mean: bool
) -> tuple[float, NDArray[np.float64], NDArray[np.float64] | None]:
    """Return DN / 2^bits per unit of exposed irradiance, what is stored without light, ``(C,)``, and the rows' exposures.

    The gain is that of the rows' mean exposure time, the offset their mean; the exposures, ``(H,)``, are multiples of that
    time, None where all are alike or where the forward model divided by them (``mean``, ``forward.time: mean``).
    """
    exposures = np.broadcast_to(np.asarray(sensor.exposure_s, np.float64), sensor.shape[0])
    exposure = 1.0 if mean else float(exposures.mean())
    dark = np.zeros((channels, *sensor.shape))
    offset, bright = sensor.noiseless(dark), sensor.noiseless(dark + sensor.full_scale)
    gain = float(np.mean(bright - offset)) / sensor.full_scale * exposure
    alike = mean or np.allclose(exposures, exposure, rtol=1e-9, atol=0)
    return gain, np.mean(offset, axis=(-2, -1)), None if alike else exposures / exposure


def plain_capture(
    stack: PsfStack,
    sensor_shape: tuple[int, int],
    scene_shape: tuple[int, int] | None = None,
    *,
    background: float | Array = 0.0,
    white: float = 1.0,
) -> CaptureModel:
    """Return a camera of which only the PSFs are known: gain 1, no vignetting, camera colours shown as they are.

    Radiance then has the unit of measurement / PSF, with an unknown factor where the PSF's exposure was another one.

    Args:
        stack: the PSFs; one channel (grey) or three (red, green, blue).
        sensor_shape: H, W of the measurement.
        scene_shape: h, w of the image around the centre; None takes the sensor's, the image that a pinhole in the
            mask's place would give.
        background: what the measurement shows without light, one number or one per channel.
        white: the radiance that images show as 1; see `typical_white`.

    Raises:
        InputError: a stack of other than one or three channels, or shapes and numbers that `CaptureModel` refuses.
    """
    channels = len(stack.channels)
    if channels not in (1, 3):
        raise InputError("stack", f"got channels {', '.join(stack.channels)}, expected one (grey) or red, green, blue")
    scene = sensor_shape if scene_shape is None else scene_shape
    return CaptureModel(
        stack=stack,
        sensor_shape=sensor_shape,
        scene_shape=scene,
        gain=1.0,
        offset=np.broadcast_to(np.asarray(background, np.float64), channels).copy(),
        irradiance=np.ones(scene, np.float32),
        # A third of each: its pseudo-inverse gives the grey value to red, green and blue alike.
        scene_to_camera=np.eye(3) if channels == 3 else np.full((1, 3), 1 / 3),
        white=white,
    )


def measure_reference_white(dataset: Dataset) -> float:
    """Return the radiance that images of a data set show as 1: the 99th percentile of its first 64 samples.

    One number for the whole data set; brighter light is clipped in images, as a camera's is.

    Raises:
        InputError: an empty split, or one whose scenes are black.
    """
    if len(dataset) == 0:
        raise InputError(dataset.root, f"split {dataset.split!r} is empty; generate some of its samples first")
    values = [dataset.stored(position).frame(0).rgb for position in range(min(len(dataset), _WHITE_SAMPLES))]
    white = float(np.percentile(np.stack(values), _WHITE_PERCENTILE))
    if white <= 0:
        raise InputError(dataset.root, f"the scenes of split {dataset.split!r} are black; their images have no scale")
    return white


def typical_white(capture: CaptureModel, measurement: Array) -> float:
    """Return a radiance to be shown as 1: twice the mean of a scene that sends as much light as ``(..., C, H, W)`` holds.

    For a capture whose unit is unknown; of data sets it is measured once, see `measure_reference_white`.

    Raises:
        InputError: a measurement without light above the background.
    """
    light = to_numpy(measurement).astype(np.float64) - capture.offset[:, None, None]
    # A pixel of radiance 1 gives gain x irradiance x the PSF's sum, were the sensor large enough to hold it.
    response = capture.gain * np.mean(np.sum(to_numpy(capture.stack.values), axis=(-2, -1), dtype=np.float64), axis=0)
    per_scene = np.sum(light, axis=(-2, -1)) / (response * np.sum(capture.irradiance, dtype=np.float64))
    mean = float(np.mean(per_scene))
    if not mean > 0:
        raise InputError("measurement", f"got a mean radiance of {mean:.3g}, expected light; check the background")
    return 2 * mean
