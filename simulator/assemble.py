"""From a configuration to the objects of the light path: mask, camera, PSF stack, view, scenes, sensor, forward model."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator import __version__
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.camera.noise import GaussianNoise, Noise, NoNoise, PhysicalNoise
from simulator.camera.planes import mask_irradiance
from simulator.camera.sensor import MODELS, Sensor
from simulator.camera.shutter import GlobalShutter
from simulator.config import camera as camera_config
from simulator.config.psf import ComputedPsf, MeasuredPsf
from simulator.errors import InputError
from simulator.files import StorageError
from simulator.optics.cache import Entry, cached
from simulator.optics.mask import UNNAMED, Mask
from simulator.optics.materials import Material
from simulator.optics.psf import Progress, PsfConfig, compute_psf_stack, psf_fingerprint
from simulator.optics.psf_stack import PsfStack, depth_planes
from simulator.optics.spectrum import NOMINAL_CAMERA, spectral_response
from simulator.plugin_files import describe_failure
from simulator.plugins import Plugin, resolve
from simulator.types import CameraGeometry, SceneSource, View

if TYPE_CHECKING:
    from simulator.config import Config


_OWN_PACKAGES = ("simulator", "scenes", "psf_library")


def build_mask(config: Config) -> Mask | None:
    """Return the mask of a configuration, designed once and then cached; None when the PSF was measured."""
    chosen = config.camera.mask
    return None if chosen is None else load_mask(chosen.design, config.base_dir, **chosen.params)


def load_mask(design: str, base_dir: Path | None = None, **params: Any) -> Mask:
    """Design a mask, or take it from the cache when the same design was made before.

    Args:
        design: a design's name, ``./file.py:name`` or ``package.module:name``.
        base_dir: folder from which relative paths are taken; None is the current one.
        params: the design's parameters; see ``flatlight masks``.

    Raises:
        InputError: for an unknown design or wrong parameters.
    """
    plugin = resolve("mask", design, base_dir)
    arguments = plugin.bind(params)
    key = hashlib.sha256(repr((design, sorted(arguments.items()), _code(plugin))).encode())
    for value in arguments.values():
        if isinstance(value, Path) and value.is_file():
            key.update(value.read_bytes())

    def compute() -> Entry:
        with plugin_errors(plugin):
            mask = plugin.function(**arguments)
        if not isinstance(mask, Mask):
            msg = f"mask design {design!r} returned {type(mask).__name__}, expected a simulator.optics.mask.Mask"
            raise InputError(msg)
        described = {
            "pitch_m": mask.pitch_m,
            "material": asdict(mask.material),
            "profile": mask.profile,
            "name": plugin.function.__name__ if mask.name == UNNAMED else mask.name,
        }
        arrays = {"height_m": mask.height_m, "amplitude": mask.amplitude}
        return {name: np.asarray(array, np.float32) for name, array in arrays.items()}, described

    arrays, described = cached("masks", key.hexdigest(), compute)
    material = described["material"] | {key: tuple(described["material"][key]) for key in ("coefficients", "range_m")}
    return Mask(
        arrays["height_m"],
        arrays["amplitude"],
        described["pitch_m"],
        Material(**material),
        described["profile"],
        described["name"],
    )


def build_geometry(config: Config) -> CameraGeometry:
    """Return what the optics need to know of the camera.

    Raises:
        InputError: for an unknown illuminant or spectral response.
    """
    chosen = config.camera.sensor.spectral_response or NOMINAL_CAMERA
    response = spectral_response(chosen, config.camera.illuminant)
    return CameraGeometry(_distance_m(config), build_sensor(config).binned_pitch_m, response)


def build_psf_config(config: Config) -> PsfConfig:
    """Return how to compute the stack of a configuration with a computed PSF."""
    chosen = config.psf
    assert isinstance(chosen, ComputedPsf)
    if chosen.depths_cm is not None:
        depths = [depth * 1e-2 for depth in chosen.depths_cm]
    elif chosen.depths == 1:
        depths = [chosen.nearest_cm * 1e-2]
    else:
        assert chosen.near_cm is not None
        assert chosen.far_cm is not None
        assert chosen.depths is not None
        depths = depth_planes(chosen.near_cm * 1e-2, chosen.far_cm * 1e-2, chosen.depths, chosen.spacing)
    return PsfConfig(
        tuple(float(depth) for depth in depths),
        chosen.model,
        chosen.wavelengths_per_channel,
        chosen.oversampling,
        chosen.accept_error,
    )


def build_psf_stack(config: Config, *, threads: int = 1, progress: Progress | None = None) -> PsfStack:
    """Compute the PSF stack (cached) or read the measured one.

    Args:
        config: the configuration.
        threads: depths computed at a time.
        progress: called with (done, total) while PSFs are computed.
    """
    if isinstance(config.psf, MeasuredPsf):
        return _measured_stack(config, config.psf)
    mask = build_mask(config)
    assert mask is not None
    geometry, psf_config = build_geometry(config), build_psf_config(config)
    fingerprint = psf_fingerprint(mask, geometry, psf_config)

    def compute() -> Entry:
        stack = compute_psf_stack(mask, geometry, psf_config, threads=threads, progress=progress)
        described = {"channels": stack.channels, "provenance": stack.provenance}
        return {"values": stack.values, "depths_m": stack.depths_m}, described

    # The limit is no part of the values, but a stack cached under a loose one must not pass a tight one.
    key = hashlib.sha256(repr((fingerprint, psf_config.accept_error, _optics_code())).encode()).hexdigest()
    arrays, described = cached("psf", key, compute)
    return PsfStack(
        arrays["values"],
        arrays["depths_m"],
        geometry.pixel_pitch_m,
        tuple(described["channels"]),
        fingerprint,
        described["provenance"],
    )


def build_view(config: Config) -> View:
    """Return the pinhole view that scenes are drawn for; its depths are the stack's unless the scene has its own."""
    chosen = config.psf
    if isinstance(chosen, ComputedPsf):
        depths = build_psf_config(config).depths_m
    else:
        depths = tuple(depth * 1e-2 for depth in chosen.depths_cm)
    near_cm, far_cm = config.scene.near_cm, config.scene.far_cm
    return View(
        config.scene.size,
        build_sensor(config).binned_pitch_m,
        _distance_m(config),
        depths[0] if near_cm is None else near_cm * 1e-2,
        depths[-1] if far_cm is None else far_cm * 1e-2,
    )


def scene_plugin(config: Config) -> Plugin:
    """Return the plugin that makes the scenes."""
    scene = config.scene
    kind, name = ("scene", scene.family) if scene.family is not None else ("source", scene.source)
    assert name is not None
    return resolve(kind, name, config.base_dir)


def build_source(config: Config, backend: str) -> SceneSource:
    """Return the scene source.

    Args:
        config: the configuration.
        backend: Mitsuba variant for families that render.
    """
    plugin = scene_plugin(config)
    arguments = plugin.bind(config.scene.params)
    if plugin.takes_backend:
        arguments["backend"] = backend
    with plugin_errors(plugin):
        source = plugin.function(build_view(config), **arguments)
    if not isinstance(source, SceneSource):
        msg = f"scene {plugin.name!r} returned {type(source).__name__}, expected an object with inputs and clip(index, rng)"
        raise InputError(msg)
    return source


@contextmanager
def plugin_errors(plugin: Plugin) -> Iterator[None]:
    """Name the user's own code, and its line, where it fails; the failures of built-in plugins stay ours.

    Raises:
        InputError: for anything that a ``./file.py:name`` or ``package.module:name`` raises.
    """
    try:
        yield
    except Exception as error:
        if ":" not in plugin.name or isinstance(error, StorageError):
            raise
        label = f"{plugin.kind} {plugin.name!r}"
        if isinstance(error, InputError):
            msg = f"{label}: {error}"
        else:
            msg = describe_failure(error, label, plugin.path.resolve() if plugin.path else None)
        raise InputError(msg) from error


def build_sensor(config: Config, full_scale: float = 1.0) -> Sensor:
    """Return the sensor: the model's numbers, with those that the configuration replaces.

    Raises:
        InputError: for an unknown model, or a picture larger than the sensor.
    """
    chosen, camera = config.camera.sensor, config.camera
    if chosen.model not in MODELS:
        msg = f"camera.sensor.model: got {chosen.model!r}, expected one of {', '.join(MODELS)}"
        raise InputError(msg)
    numbers = dict(MODELS[chosen.model])
    for name in ("full_well_e", "read_noise_e", "dark_current_e_per_s", "black_level_dn", "bit_depth"):
        if getattr(chosen, name) is not None:
            numbers[name] = getattr(chosen, name)
    if chosen.pixel_pitch_um is not None:
        numbers["pixel_pitch_m"] = chosen.pixel_pitch_um * 1e-6
    if chosen.prnu_percent is not None:
        numbers["prnu"] = chosen.prnu_percent * 1e-2
    return Sensor(
        name=chosen.model,
        binning=chosen.binning,
        shape=chosen.shape,
        exposure_s=camera.shutter.exposure_ms * 1e-3,
        full_scale=full_scale,
        noise=_noise(camera.noise),
        **numbers,
    )


def build_forward_model(config: Config, stack: PsfStack) -> ForwardModel:
    """Return the forward model of a configuration and its PSF stack."""
    chosen = config.forward
    return ForwardModel(
        stack,
        config.camera.sensor.shape,
        config.scene.size,
        GlobalShutter(config.camera.shutter.exposure_ms * 1e-3),
        chosen.boundary,
        irradiance=mask_irradiance(build_view(config), chosen.vignetting),
        depth_rule=DepthRule(chosen.depth_assignment, chosen.max_clamped),
    )


def input_files(config: Config, source: SceneSource) -> list[Path]:
    """Return all files whose contents decide the samples: plugins' own code, measured PSFs, imported frames."""
    files = _own_code(scene_plugin(config))
    if config.camera.mask is not None:
        plugin = resolve("mask", config.camera.mask.design, config.base_dir)
        files += [
            *_own_code(plugin),
            *(v for v in plugin.bind(config.camera.mask.params).values() if isinstance(v, Path)),
        ]
    if isinstance(config.psf, MeasuredPsf):
        files += [config.resolve_path(name) for name in config.psf.measured]
        background = _background(config, config.psf)
        files += [background] if isinstance(background, Path) else []
    return [*files, *source.inputs]


def _measured_stack(config: Config, chosen: MeasuredPsf) -> PsfStack:
    from simulator.optics.measured import load_measured_psf

    sensor = build_sensor(config)
    stack = load_measured_psf(
        [config.resolve_path(name) for name in chosen.measured],
        [depth * 1e-2 for depth in chosen.depths_cm],
        sensor.binned_pitch_m,
        frame=chosen.frame,
        binning=chosen.binning,
        background=_background(config, chosen),
        throughput_m2=chosen.throughput_mm2 * 1e-6,
    )
    for axis, have, physical in zip(("rows", "columns"), stack.values.shape[-2:], sensor.physical_shape, strict=True):
        if have * sensor.binning > physical:
            msg = (
                f"psf.binning: {chosen.binning} leaves pictures of {have} {axis}, but sensor {sensor.name!r} has only "
                f"{physical // sensor.binning} binned ones of {sensor.binned_pitch_m * 1e6:g} um; the PSF's pixels must "
                "become the sensor's binned pixels: raise psf.binning"
            )
            raise InputError(msg)
    return stack


def _background(config: Config, chosen: MeasuredPsf) -> Any:
    named = isinstance(chosen.background, str) and chosen.background not in ("border", "none")
    return config.resolve_path(str(chosen.background)) if named else chosen.background


def _distance_m(config: Config) -> float:
    return config.camera.mask_to_sensor_mm * 1e-3


def _noise(chosen: Any) -> Noise:
    if isinstance(chosen, camera_config.GaussianNoise):
        return GaussianNoise(chosen.std, chosen.psnr_db, chosen.peak, chosen.clip, chosen.quantise)
    return PhysicalNoise() if isinstance(chosen, camera_config.PhysicalNoise) else NoNoise()


def _own_code(plugin: Plugin) -> list[Path]:
    """Return the file of a plugin's code unless it came with flatlight, whose version stands for it."""
    module = inspect.getmodule(plugin.function)
    if plugin.path is None and module is not None and module.__name__.partition(".")[0] in _OWN_PACKAGES:
        return []
    path = plugin.path or inspect.getsourcefile(plugin.function)
    return [Path(path)] if path else []


def _code(plugin: Plugin) -> str:
    """Return a hash of a design's code: its own module and everything in the optics room."""
    source = Path(inspect.getsourcefile(plugin.function) or "")
    return hashlib.sha256((source.read_bytes() if source.is_file() else b"") + _optics_code().encode()).hexdigest()


@cache
def _optics_code() -> str:
    folder = Path(__file__).parent / "optics"
    sha = hashlib.sha256(f"{__version__} {np.__version__}".encode())
    for path in sorted(folder.glob("*.py")):
        sha.update(path.read_bytes())
    return sha.hexdigest()
