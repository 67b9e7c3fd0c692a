"""From a configuration to the parts of the light path, each built once: the only place that knows both."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, wraps
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.camera.colour import CameraColour, fit_camera_colour
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.camera.noise import NoNoise
from simulator.camera.sensor import Sensor
from simulator.camera.shutter import Shutter, read_row_shutter, row_shutter
from simulator.camera.surroundings import WORDS
from simulator.config import Config
from simulator.config.camera import GapLayer, RowWindows
from simulator.config.psf import ComputedPsf
from simulator.design.load import load_mask, mask_arguments
from simulator.errors import InputError
from simulator.io.cache import Entry, cached, code_digest, is_cached
from simulator.io.files import sha256_file
from simulator.measured_psf import measured_depths_m, measured_files, measured_stack
from simulator.optics.error_budget import budget
from simulator.optics.error_budget.direct_sum import llvm_works
from simulator.optics.mask import Mask
from simulator.optics.materials import AIR, Material, load_material, material_file
from simulator.optics.propagation import air_equivalent_m
from simulator.optics.psf import PsfConfig, compute_psf_stack, psf_fingerprint, psf_lines
from simulator.optics.spectra import (
    NOMINAL_CAMERA,
    Led,
    check_materials,
    curve_file,
    electron_rates,
    spectral_response,
)
from simulator.optics.stack import PsfStack, of_depths
from simulator.plugins import Plugin, plugin_errors, resolve
from simulator.simulated_field import SimulatedField
from simulator.types import CameraGeometry, Layer, SceneSource, SpectralResponse, View

EQUIVALENT_WAVELENGTH_M = 550e-9
"""Where a layer's thickness becomes a distance in air: the middle of the visible."""

_OWN_PACKAGES = ("simulator", "scenes", "psf_library")
_CHECKS = {"model": "exact PSFs", "planes": "planes", "direct_sum": "direct sums", "field": "directions"}

Progress = Callable[[str, int, int], None]  # (what, done, total)


Part = TypeVar("Part")


def part(*sections: str) -> Callable[[Callable[[Assembly], Part]], cached_property[Part]]:
    """Return the decorator of a part that is built once; what it refuses is named by keys (`Config.refusals`)."""

    def decorate(build: Callable[[Assembly], Part]) -> cached_property[Part]:
        @wraps(build)
        def named(assembly: Assembly) -> Part:
            with assembly.config.refusals(*sections):
                return build(assembly)

        return cached_property(named)

    return decorate


@dataclass(frozen=True)
class Assembly:
    """A configuration's parts, each built when it is first asked for and then kept.

    A part raises ``InputError`` where the configuration names what does not exist, cannot be read or does not fit.

    Attributes:
        config: the configuration.
        backend: Mitsuba variant for scenes that are rendered; ``none`` for imported ones.
        threads: depths of the PSF stack that are computed at a time.
        progress: called with (what, done, total) while PSFs are computed.

    Example:
        >>> from simulator.config import config_from_dict, default_config_text
        >>> import yaml
        >>> assembly = Assembly(config_from_dict(yaml.safe_load(default_config_text())))
        >>> round(assembly.pixel_pitch_m * 1e6, 6), len(assembly.depths_m)
        (19.2, 28)
    """

    config: Config
    backend: str = "none"
    threads: int = field(default=1, compare=False)
    progress: Progress | None = field(default=None, compare=False, repr=False)

    def having(self, **parts: Any) -> Self:
        """Return a copy in which some parts are there already, such as a ``psf_stack`` or ``shutter`` from a data set."""
        copy = replace(self)
        copy.__dict__.update(parts)
        return copy

    # ---- geometry

    @cached_property
    def pixel_pitch_m(self) -> float:
        """Pitch of the stored (binned) values, metres."""
        return self.config.camera.sensor.binned_pitch_m

    @part("camera.gap", "camera.substrate")
    def gap(self) -> tuple[Layer, ...]:
        """The layers from the mask's modulating surface to the sensor; none where air alone lies between them."""
        camera, plate = self.config.camera, self._plate("sensor")
        if camera.gap is not None:
            return (*plate, *(Layer(layer.mm * 1e-3, self._medium(layer)) for layer in camera.gap))
        assert camera.mask_to_sensor_mm is not None
        return (*plate, Layer(camera.mask_to_sensor_mm * 1e-3, AIR)) if plate else ()

    @cached_property
    def mask_to_sensor_m(self) -> float:
        """Distance in air at which paraxial rays from the mask arrive at the same place: the sum of d / n, metres."""
        if self.gap:
            return air_equivalent_m(self.gap, EQUIVALENT_WAVELENGTH_M)
        assert self.config.camera.mask_to_sensor_mm is not None
        return self.config.camera.mask_to_sensor_mm * 1e-3

    @part("camera")
    def geometry(self) -> CameraGeometry:
        """What the optics need to know of the camera."""
        return self.geometry_of(self.response)

    def geometry_of(self, response: SpectralResponse) -> CameraGeometry:
        """Return the same of another spectral response."""
        return CameraGeometry(self.mask_to_sensor_m, self.pixel_pitch_m, response, self.gap, self._plate("scene"))

    @part("psf")
    def depths_m(self) -> tuple[float, ...]:
        """The depths of the stack, metres, without making it."""
        chosen = self.config.psf
        return chosen.depths_m if isinstance(chosen, ComputedPsf) else measured_depths_m(self.config, chosen)

    @part("scene")
    def view(self) -> View:
        """The pinhole view that scenes are drawn for; its depths are the stack's unless the scene has its own."""
        return replace(self.image_view, margin=self.simulated_field.margin)

    @cached_property
    def image_view(self) -> View:
        """The view without its margin."""
        near_cm, far_cm = self.config.scene.near_cm, self.config.scene.far_cm
        return View(
            self.config.scene.size,
            self.pixel_pitch_m,
            self.mask_to_sensor_m,
            self.depths_m[0] if near_cm is None else near_cm * 1e-2,
            self.depths_m[-1] if far_cm is None else far_cm * 1e-2,
        )

    @cached_property
    def simulated_field(self) -> SimulatedField:
        """What beside the image is simulated, how light from each direction counts, and what is left out."""
        return SimulatedField(self.config, self.image_view, lambda: self.nearest_light)

    @part("psf")
    def nearest_light(self) -> NDArray[np.floating]:
        """Where the light of the nearest depth falls, ``(rows, columns)``: how far beside the image light matters.

        One PSF of one wavelength says that in about a second, before any other is computed (cached).
        """
        mask, near_m = self.mask, self.depths_m[0]
        if mask is None:
            return to_numpy(self._measured_stack.values)[0].sum(axis=0)
        green = SpectralResponse(
            EQUIVALENT_WAVELENGTH_M + np.array([-5e-9, 0, 5e-9]), np.eye(3)[1:2], ("G",), "one line"
        )
        geometry = self.geometry_of(green)
        config = PsfConfig((near_m,), "scaled_distance", 1, self.psf_config.oversampling)

        def compute() -> Entry:
            return {"light": to_numpy(compute_psf_stack(mask, geometry, config).values)[0, 0]}, {}

        key = repr((psf_fingerprint(mask, geometry, config), code_digest("simulator.optics.psf")))
        return cached("reach", hashlib.sha256(key.encode()).hexdigest(), compute)[0]["light"]

    # ---- light

    @part("camera.illuminant", "camera", "camera.sensor")
    def response(self) -> SpectralResponse:
        """The relative photon weights of the camera's channels under the configuration's light (cached)."""
        camera, illuminant, folder = self._camera, self._illuminant, self.config.base_dir

        def compute() -> Entry:
            found = spectral_response(camera, illuminant, folder)
            arrays = {"wavelengths_m": found.wavelengths_m, "weights": found.weights}
            return arrays, {"channels": found.channels, "label": found.label}

        arrays, described = cached("response", self._light_key("simulator.optics.spectra"), compute)
        return SpectralResponse(channels=tuple(described["channels"]), label=described["label"], **arrays)

    @part("camera.illuminant", "camera", "camera.sensor")
    def electron_rates(self) -> dict[str, float]:
        """The electrons that white gives in each channel (cached); see `simulator.optics.spectra.electron_rates`."""
        folder = self.config.base_dir

        def compute() -> Entry:
            rates = electron_rates(self._camera, self._illuminant, folder)
            return {"rates": np.array(list(rates.values()))}, {"channels": list(rates)}

        arrays, described = cached("photometry", self._light_key("simulator.optics.spectra"), compute)
        return dict(zip(described["channels"], arrays["rates"].tolist(), strict=True))

    def camera_colour(self, channels: tuple[str, ...]) -> CameraColour:
        """Return how the scene's linear sRGB becomes the camera's channels; a fitted matrix is cached.

        Args:
            channels: names of the PSF stack's channels.

        Raises:
            InputError: when the matrix does not have a row per channel.
        """
        with self.config.refusals("camera", "camera.sensor"):
            chosen = self.config.camera.scene_to_camera
            if chosen == "identity":
                colour = CameraColour(np.eye(3), {"from": "identity"})
            elif chosen == "auto":
                folder = self.config.base_dir

                def compute() -> Entry:
                    fitted = fit_camera_colour(spectral_response(self._camera, self._illuminant, folder))
                    return {"matrix": fitted.matrix}, {"origin": fitted.origin}

                arrays, described = cached(
                    "colour", self._light_key("simulator.camera.colour", "simulator.optics.spectra"), compute
                )
                colour = CameraColour(arrays["matrix"], described["origin"])
            else:
                colour = CameraColour(np.array(chosen, np.float64), {"from": "configuration"})
            if len(colour.matrix) != len(channels):
                said = chosen if isinstance(chosen, str) else "the matrix"
                raise InputError(
                    "camera.scene_to_camera",
                    f"{said} has {len(colour.matrix)} rows, but the PSF stack has the channels {', '.join(channels)}; give "
                    "a list with a row of three numbers for each",
                )
            return colour

    # ---- mask and PSFs

    @part("camera.mask")
    def mask(self) -> Mask | None:
        """The mask, designed once and then cached on disk; None when the PSF was measured."""
        chosen = self.config.camera.mask
        return None if chosen is None else load_mask(chosen.design, self.config.base_dir, **chosen.params)

    @cached_property
    def psf_config(self) -> PsfConfig:
        """How to compute the stack of a configuration with a computed PSF."""
        chosen = self.config.psf
        assert isinstance(chosen, ComputedPsf)
        return PsfConfig(
            chosen.depths_m,
            chosen.model,
            chosen.wavelengths_per_channel,
            chosen.oversampling,
            chosen.accept_error,
            chosen.shared_wavelengths,
        )

    @part("psf")
    def psf_stack(self) -> PsfStack:
        """The PSF stack: computed (and cached on disk), or measured."""
        if not isinstance(self.config.psf, ComputedPsf):
            return budget.with_rows(self._measured_stack, [self.simulated_field.budget_row(self._measured_stack)])
        stack = self._proven_stack(self.psf_config)
        errors = self._quick_errors(self.psf_config, self.image_view, stack)
        return budget.with_budget(stack, errors, [self.simulated_field.budget_row(stack)])

    def some_depths(self, most: int) -> PsfStack:
        """Return the PSFs of at most so many of the stack's depths (of two at least): both ends, and others evenly between.

        Of a computed stack only these are computed, unless the whole is in the cache. The errors that it carries (sampling,
        model, wavelengths) are judged at the ends, so they are those of the whole.
        """
        kept = np.unique(np.linspace(0, len(self.depths_m) - 1, max(most, 2)).round().astype(int))
        with self.config.refusals("psf"):
            if not isinstance(self.config.psf, ComputedPsf):
                return of_depths(self.psf_stack, kept)
            whole, mask = self.psf_config, self.mask
            assert mask is not None
            some = replace(whole, depths_m=tuple(whole.depths_m[k] for k in kept))
            if is_cached("psf", self._stack_key(whole)):
                taken = of_depths(self._proven_stack(whole), kept)
                stack = replace(taken, fingerprint=psf_fingerprint(mask, self.geometry, some))
            else:
                stack = self._proven_stack(some)
            return budget.with_budget(stack, self._quick_errors(replace(whole, depths_m=whole.depths_m[:1])))

    def _proven_stack(self, psf_config: PsfConfig) -> PsfStack:
        """Return the mask's PSFs with their sampling proven (cached)."""
        mask, geometry = self.mask, self.geometry
        assert mask is not None
        lines = psf_lines(geometry.response, psf_config)
        layers = [layer.material for layer in (*geometry.gap, *geometry.window)]
        check_materials(geometry.response, lines, [mask.material, *layers])

        def compute() -> Entry:
            progress = None if self.progress is None else partial(self.progress, "PSFs")
            stack = budget.proven_psf_stack(mask, geometry, psf_config, threads=self.threads, progress=progress)
            described = {"channels": stack.channels, "provenance": stack.provenance}
            return {"values": stack.values, "depths_m": stack.depths_m}, described

        arrays, described = cached("psf", self._stack_key(psf_config), compute)
        return PsfStack(
            arrays["values"],
            arrays["depths_m"],
            geometry.pixel_pitch_m,
            tuple(described["channels"]),
            psf_fingerprint(mask, geometry, psf_config),
            described["provenance"],
        )

    def _stack_key(self, psf_config: PsfConfig) -> str:
        # The limit is not part of the values, but a stack cached under a loose one must not pass a tight one.
        return self._psf_key(psf_config, psf_config.accept_error)

    def _quick_errors(
        self, psf_config: PsfConfig, view: View | None = None, stack: PsfStack | None = None
    ) -> dict[str, Any]:
        """Return what `budget.quick_errors` finds (cached)."""
        mask = self.mask
        assert mask is not None

        def judge() -> Entry:
            return {}, budget.quick_errors(mask, self.geometry, psf_config, view, stack=stack, threads=self.threads)

        return cached("budget", self._psf_key(psf_config, view), judge)[1]

    def _psf_key(self, psf_config: PsfConfig, more: Any) -> str:
        assert self.mask is not None
        key = repr((psf_fingerprint(self.mask, self.geometry, psf_config), more, code_digest(budget.__name__)))
        return hashlib.sha256(key.encode()).hexdigest()

    @part("psf")
    def _measured_stack(self) -> PsfStack:
        assert not isinstance(self.config.psf, ComputedPsf)
        return measured_stack(self.config, self.config.psf, self.geometry, self.config.camera.sensor.sensor(NoNoise()))

    @property
    def wants_full_check(self) -> bool:
        """Whether the configuration asks for the full error budget (``psf.check: full``)."""
        return isinstance(self.config.psf, ComputedPsf) and self.config.psf.check == "full"

    @part()
    def checked_stack(self) -> PsfStack:
        """The PSF stack with the full error budget in its provenance: minutes of work, cached on disk.

        Raises:
            InputError: for a measured stack, which has no model to be checked.
        """
        mask, stack = self.mask, self.psf_stack
        if mask is None:
            raise InputError(
                "--check",
                "the PSF of this configuration was measured, so there is no model to check; leave --check out",
            )
        told = {} if self.progress is None else {part: partial(self.progress, name) for part, name in _CHECKS.items()}

        def compute() -> Entry:
            return {}, budget.full_errors(
                mask, self.geometry, self.psf_config, self.image_view, stack=stack, threads=self.threads, progress=told
            )

        key = repr((stack.fingerprint, self.image_view, llvm_works(), code_digest(budget.__name__)))
        _, errors = cached("check", hashlib.sha256(key.encode()).hexdigest(), compute)
        return budget.with_budget(stack, errors, [self.simulated_field.budget_row(stack)])

    # ---- sensor

    @part("camera.shutter")
    def shutter(self) -> Shutter:
        """The shutter; a user's function is called for its windows once."""
        chosen, binning = self.config.camera.shutter, self.config.camera.sensor.binning
        if not isinstance(chosen, RowWindows):
            return replace(chosen, binning=binning)
        rows, plugin = self.config.camera.sensor.shape[0], self._shutter_plugin
        if plugin is None:
            assert chosen.file is not None
            path = self.config.resolve_path(chosen.file)
            try:
                return read_row_shutter(path, rows, binning)
            except InputError as error:
                raise InputError("camera.shutter.file", str(error)) from error
        with plugin_errors(plugin):
            windows = plugin.function(rows * binning, **plugin.bind(chosen.params))
        return row_shutter(windows, rows, binning, f"camera.shutter.function ({plugin.name})")

    @part("camera.sensor", "camera.exposure")
    def sensor(self) -> Sensor:
        """The sensor at ``full_scale`` 1: the model's numbers, with those that the configuration replaces.

        Where the configuration gives the scene's illuminance, channels count as many electrons as their spectral responses
        say. ``replace(sensor, full_scale=...)`` sets the exposure that fills a pixel.
        """
        camera, responsivity = self.config.camera, None
        if camera.exposure.illuminance_lux is not None:
            responsivity = tuple(rate / max(self.electron_rates.values()) for rate in self.electron_rates.values())
        exposure_s: float | tuple[float, ...]
        if isinstance(camera.shutter, RowWindows):
            # The stored image is the physical one rotated by 180 degrees.
            exposure_s = tuple(self.shutter.exposures_s(camera.sensor.shape[0])[::-1].tolist())
        else:
            exposure_s = camera.shutter.exposure_s
        bare = camera.sensor.sensor(camera.noise)
        return replace(bare, exposure_s=exposure_s, responsivity=responsivity)

    @part("camera.exposure")
    def fixed_exposure(self) -> dict[str, Any] | None:
        """The exposure as a data set records it, or None where pilot samples must find it.

        ``full_scale`` is the radiant exposure (scene radiance x steradian x seconds, per unit irradiance at the mask) that
        fills a pixel. With ``illuminance_lux``, a scene radiance of 1 is a white surface lit so brightly, and the pixel is
        one of the channel that counts the most electrons for white.
        """
        chosen = self.config.camera.exposure
        if chosen.illuminance_lux is None:
            found = chosen.full_scale == "auto"
            return None if found else {"full_scale": float(chosen.full_scale), "from": "configuration"}
        sensor, rates = self.sensor, self.electron_rates
        per_lux = max(rates.values()) * sensor.peak_quantum_efficiency * sensor.pixel_pitch_m**2
        electrons = chosen.illuminance_lux * per_lux
        own_efficiency = self.config.camera.sensor.peak_quantum_efficiency is not None
        assert sensor.responsivity is not None
        return {
            "full_scale": sensor.full_well_e / electrons,
            "from": "illuminance",
            "illuminance_lux": chosen.illuminance_lux,
            "peak_quantum_efficiency": sensor.peak_quantum_efficiency,
            "peak_quantum_efficiency_from": "configuration" if own_efficiency else sensor.source,
            "full_well_e": sensor.full_well_e,
            "electrons_per_exposure": electrons,
            "responsivity": dict(zip(rates, sensor.responsivity, strict=True)),
        }

    @part("forward", "camera")
    def forward_model(self) -> ForwardModel:
        """The forward model: light of the whole field, image and margin, over time to the exposure of the sensor."""
        chosen = self.config.forward
        return ForwardModel(
            self.psf_stack,
            self.config.camera.sensor.shape,
            self.view.field.shape,
            self.shutter,
            chosen.boundary,
            time=chosen.time,
            irradiance=self.simulated_field.of_view.irradiance(self.view.field),
            scene_to_camera=self.camera_colour(self.psf_stack.channels).matrix,
            depth_rule=DepthRule(chosen.depth_assignment, chosen.max_clamped),
        )

    # ---- scenes and files

    @part("scene")
    def scene_plugin(self) -> Plugin:
        """The plugin that makes the scenes."""
        scene = self.config.scene
        kind, name = ("scene", scene.family) if scene.family is not None else ("source", scene.source)
        assert name is not None
        return resolve(kind, name, self.config.base_dir)

    @part("scene")
    def source(self) -> SceneSource:
        """The scene source."""
        plugin, view = self.scene_plugin, self.view
        arguments = plugin.bind(self.config.scene.params)
        if plugin.takes_renderer:
            from simulator.render import Renderer  # imported data sets need no renderer

            chosen = self.config.render
            bands_nm = chosen.bands.edges if chosen.bands else ()
            arguments["renderer"] = Renderer(
                self.backend, tuple(chosen.outputs), chosen.hidden_layers, denoise=chosen.denoise, bands_nm=bands_nm
            )
        with plugin_errors(plugin):
            source = plugin.function(view, **arguments)
        if not isinstance(source, SceneSource):
            raise InputError(
                f"scene {plugin.name!r}",
                f"returned {type(source).__name__}, expected an object with inputs and clip(index, rng)",
            )
        return source

    @part("scene")
    def input_files(self) -> list[Path]:
        """All files whose contents decide the samples: plugins' code, materials, spectra, shutters, PSFs, frames."""
        config, camera = self.config, self.config.camera
        materials = [layer.material for layer in camera.gap or () if layer.material is not None]
        if camera.substrate is not None:
            materials.append(camera.substrate.material)
        files = _own_code(self.scene_plugin)
        files += [
            file for name in dict.fromkeys(materials) if (file := material_file(name, config.base_dir)) is not None
        ]
        files += self._light_files
        if isinstance(camera.sensor.angular_response, str):
            files.append(config.resolve_path(camera.sensor.angular_response))
        if config.scene.surroundings not in (None, *WORDS):
            files.append(config.resolve_path(config.scene.surroundings))
        if (shutter := self._shutter_plugin) is not None and isinstance(camera.shutter, RowWindows):
            files += [value for value in shutter.bind(camera.shutter.params).values() if isinstance(value, Path)]
            files += _own_code(shutter)
        elif isinstance(camera.shutter, RowWindows) and camera.shutter.file is not None:
            files.append(config.resolve_path(camera.shutter.file))
        if camera.mask is not None:
            plugin = resolve("mask", camera.mask.design, config.base_dir)
            files += [*_own_code(plugin), *mask_arguments(plugin, camera.mask.params)[1]]
        if not isinstance(config.psf, ComputedPsf):
            files += measured_files(config, config.psf)
        return [*files, *self.source.inputs]

    # ---- what the parts share

    @part("camera.shutter")
    def _shutter_plugin(self) -> Plugin | None:
        chosen = self.config.camera.shutter
        if not isinstance(chosen, RowWindows) or chosen.function is None:
            return None
        return resolve("shutter", chosen.function, self.config.base_dir)

    def _plate(self, side: str) -> tuple[Layer, ...]:
        """Return the mask's substrate, if it lies on that side of the modulating surface."""
        plate = self.config.camera.substrate
        if plate is None or plate.side != side:
            return ()
        return (Layer(plate.mm * 1e-3, load_material(plate.material, self.config.base_dir)),)

    def _medium(self, layer: GapLayer) -> Material:
        if layer.material is not None:
            return load_material(layer.material, self.config.base_dir)
        assert layer.n is not None
        if layer.n == "air":
            return AIR
        return Material(f"n = {layer.n:g}", "cauchy", (layer.n,), AIR.range_m, "constant index of the configuration")

    @property
    def _camera(self) -> str:
        return self.config.camera.sensor.spectral_response or NOMINAL_CAMERA

    @property
    def _illuminant(self) -> str | tuple[Led, ...]:
        chosen = self.config.camera.illuminant
        if isinstance(chosen, str):
            return chosen
        return chosen if isinstance(chosen, tuple) else (chosen,)

    @property
    def _light_files(self) -> list[Path]:
        """The files of the camera's curves and of the light's spectrum."""
        captured = getattr(self.config.psf, "as_captured", None)
        lights = (self.config.camera.illuminant, None if captured is None else captured.illuminant)
        names = [name for name in (self._camera, *lights) if isinstance(name, str)]
        return [file for name in names if (file := curve_file(name, self.config.base_dir)) is not None]

    def _light_key(self, *modules: str) -> str:
        """Return a hash of the camera and its light, without colour-science, which takes seconds to import."""
        hashes = [sha256_file(path) for path in self._light_files]
        return hashlib.sha256(
            repr((self._camera, self._illuminant, hashes, code_digest(*modules))).encode()
        ).hexdigest()


def _own_code(plugin: Plugin) -> list[Path]:
    """Return the file of a plugin's code unless it came with flatlight, whose version stands for it."""
    module = inspect.getmodule(plugin.function)
    if plugin.path is None and module is not None and module.__name__.partition(".")[0] in _OWN_PACKAGES:
        return []
    path = plugin.path or inspect.getsourcefile(plugin.function)
    return [Path(path)] if path else []
