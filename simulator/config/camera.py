"""The camera section: layers and light, shutter, mask, sensor, exposure and noise."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from simulator.camera.field import CosinePower
from simulator.camera.noise import GaussianNoise, Noise, NoNoise, PhysicalNoise
from simulator.camera.sensor import MODELS, Sensor
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter
from simulator.errors import InputError
from simulator.optics.spectra import Led
from simulator.settings import Range
from simulator.text import nearest, show
from simulator.validation import PathText, PluginSection, Section, refusal

_THICK = Range(0.0001, 100, "mm", below="a layer has a thickness")
MaterialName = Annotated[str, Field(min_length=1)]


class GapLayer(Section):
    """A plane-parallel layer of the gap, such as air or a cover glass."""

    mm: Annotated[float, _THICK] = Field(description="thickness, millimetres")
    n: Literal["air"] | Annotated[float, Range(1, 4, below="air has 1, and nothing here has less")] | None = Field(
        default=None, description="refractive index, the same for all wavelengths; or air"
    )
    material: MaterialName | None = Field(
        default=None, description="name of a material (see flatlight materials), or its file (.csv, .yml)"
    )

    @model_validator(mode="after")
    def _one_medium(self) -> Self:
        if (self.n is None) == (self.material is None):
            came = "neither" if self.n is None else "both"
            text = f"needs exactly one of n (air or a number) and material, got {came}"
            raise refusal(text, *([] if self.n is None else ["n"]))
        return self


class Substrate(Section):
    """The plate that carries the mask's modulating surface."""

    mm: Annotated[float, _THICK] = Field(description="thickness, millimetres")
    material: MaterialName = Field(description="name of a material (see flatlight materials), or its file (.csv, .yml)")
    side: Literal["scene", "sensor"] = Field(
        description="where the plate lies, seen from the modulating surface; on the sensor's side it comes before the gap"
    )


def _illuminant_kind(data: Any) -> str:
    if isinstance(data, dict | Led):
        return "one LED"
    return "several LEDs" if isinstance(data, list | tuple) else "a name"


# The tags hold spaces, so that they cannot be mistaken for keys in a message's path.
IlluminantConfig = Annotated[
    Annotated[str, Field(min_length=1), Tag("a name")]
    | Annotated[Led, Tag("one LED")]
    | Annotated[tuple[Led, ...], Field(min_length=1), Tag("several LEDs")],
    Discriminator(_illuminant_kind),
]

Number = Annotated[float, Range(-100, 100)]
SceneToCamera = Annotated[
    Annotated[Literal["auto", "identity"], Tag("a word")]
    | Annotated[tuple[tuple[Number, Number, Number], ...], Field(min_length=1, max_length=16), Tag("a matrix")],
    Discriminator(lambda data: "a matrix" if isinstance(data, list | tuple) else "a word"),
]


class RowWindows(PluginSection):
    """A window of its own for every physical row, from a file or a function; further keys are the function's parameters."""

    type: Literal["windows"] = "windows"
    file: PathText | None = Field(
        default=None,
        description=".csv (a line per physical row, top first: open_s,close_s; the header may say _ms or _us) or .npy "
        "(rows, 2) in seconds",
    )
    function: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="./file.py:name or package.module:name: called with the number of physical rows, returns seconds "
        "(rows, 2)",
    )

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.function is None:
            for key, value in self.params.items():
                hint = nearest(key, ["file", "function"])
                text = f"unknown key, got {show(value)}; expected type and file, or function and its parameters{hint}"
                raise refusal(text, key, on_key=True)
        if (self.file is None) == (self.function is None):
            came = "neither" if self.file is None else "both"
            text = f"needs exactly one of file and function, got {came}; each says when every row opens and closes"
            raise refusal(text, *([] if self.file is None else ["file"]))
        return self


def _named(data: Any) -> Any:
    """Take a shutter without a type for a global one."""
    return {"type": "global", **data} if isinstance(data, dict) and "type" not in data else data


ShutterConfig = Annotated[
    GlobalShutter | RollingShutter | DualRollingShutter | RowWindows,
    Field(discriminator="type"),
    BeforeValidator(_named),
]


Pixels = Annotated[int, Range(1, 32768, below="an image has at least one pixel on each side")]
Shape = tuple[Pixels, Pixels]
_CFA = "RGGB"
_NEAREST_MM = 0.05  # from the mask to the sensor


AngularResponseConfig = Annotated[
    Annotated[CosinePower, Tag("a power")] | Annotated[str, Field(min_length=1), Tag("a file")],
    Discriminator(lambda data: "a power" if isinstance(data, dict | CosinePower) else "a file"),
]
_Angle = Annotated[float, Range(0.1, 179, "deg (degrees)")]
FieldStop = Annotated[
    Annotated[Literal["image"], Tag("a word")]
    | Annotated[_Angle, Tag("an angle")]
    | Annotated[tuple[_Angle, _Angle], Tag("two angles")],
    Discriminator(
        lambda data: (
            "a word" if isinstance(data, str) else "two angles" if isinstance(data, list | tuple) else "an angle"
        )
    ),
]


class MaskConfig(PluginSection):
    """The mask: the name of a design, and the design's parameters as further keys."""

    design: str = Field(description="a design's name, ./file.py:name (beside the YAML file) or package.module:name")


class SensorConfig(Section):
    """The sensor. Keys left out take the model's values."""

    model: str = Field(default="imx183", description="name of a sensor preset")
    binning: Annotated[int, Range(1, 64, below="1 means that pixels are not binned")] = Field(
        default=1, description="physical pixels per side that are read as one"
    )
    shape: Shape = Field(description="rows and columns of the image, in binned pixels")
    pixel_pitch_um: Annotated[float, Range(0.3, 100, "um")] | None = Field(
        default=None, description="pitch of the physical (unbinned) pixels, micrometres"
    )
    full_well_e: Annotated[float, Range(50, 1e8, "e (electrons)")] | None = Field(
        default=None, description="full well of a physical pixel, electrons"
    )
    read_noise_e: Annotated[float, Range(0, 1e4, "e (electrons)")] | None = Field(
        default=None, description="standard deviation of the read noise, electrons"
    )
    row_noise_e: Annotated[float, Range(0, 1e4, "e (electrons)")] | None = Field(
        default=None, description="standard deviation of the error that a physical row's pixels share, electrons"
    )
    dark_current_e_per_s: Annotated[float, Range(0, 1e6, "e/s (electrons per second)")] | None = Field(
        default=None, description="dark current of a physical pixel, electrons per second"
    )
    dsnu_e: Annotated[float, Range(0, 1e4, "e (electrons)")] | None = Field(
        default=None, description="dark-signal non-uniformity, standard deviation in electrons"
    )
    prnu_percent: Annotated[float, Range(0, 50, "percent")] | None = Field(
        default=None, description="photo-response non-uniformity, standard deviation in percent"
    )
    black_level_dn: Annotated[float, Range(0, 65535, "DN (digital numbers)")] | None = Field(
        default=None, description="digital number of no light"
    )
    bit_depth: Annotated[int, Range(4, 24, "bits")] | None = Field(default=None, description="bits of the converter")
    spectral_response: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="name of a camera's spectral curves, or their file (.csv, .json)"
    )
    peak_quantum_efficiency: (
        Annotated[float, Range(1e-3, 1, below="a sensor that counts no photons sees nothing")] | None
    ) = Field(
        default=None, description="electrons per photon where the most sensitive channel's spectral response peaks"
    )
    angular_response: AngularResponseConfig | None = Field(
        default=None,
        description="response to light from the side: a .csv file (angle_deg,response from 0 to 90), or {cosine_power: n}; "
        "the same from everywhere when left out",
    )
    readout: Literal["binned_rgb", "bayer"] = Field(
        default="binned_rgb", description="whether each value has all colours, or one (a mosaic, as in raw files)"
    )
    cfa: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = Field(
        default=None,
        description="with readout bayer: colours of the image's upper left 2 x 2 values on the sensor itself; default RGGB",
    )
    pattern_seed: Annotated[int, Range(0, 2**31, below="a seed is not negative; 0 is a seed")] = Field(
        default=0, description="seed of the fixed patterns: another one is another sensor of the same model"
    )

    @model_validator(mode="after")
    def _a_sensor_that_can_be(self) -> Self:
        if self.cfa is not None and self.readout != "bayer":
            text = (
                f"got {self.cfa} with readout {self.readout}, whose values have all colours; leave it out, or set bayer"
            )
            raise refusal(text, "cfa", on_key=True)
        if self.model not in MODELS:
            raise refusal(f"got {self.model!r}, expected one of {', '.join(MODELS)}", "model")
        try:
            self.sensor(NoNoise())
        except InputError as error:
            raise refusal(error.reason, error.path) from error
        return self

    @property
    def binned_pitch_m(self) -> float:
        """Pitch of the stored (binned) values, metres."""
        physical_m = MODELS[self.model]["pixel_pitch_m"] if self.pixel_pitch_um is None else self.pixel_pitch_um * 1e-6
        return physical_m * self.binning

    def sensor(self, noise: Noise) -> Sensor:
        """Return the sensor: the model's numbers, with those that are given in their place."""
        own = {name: getattr(self, name) for name in MODELS[self.model].keys() & type(self).model_fields.keys()}
        own["pixel_pitch_m"] = None if self.pixel_pitch_um is None else self.pixel_pitch_um * 1e-6
        own["prnu"] = None if self.prnu_percent is None else self.prnu_percent * 1e-2
        return Sensor(
            name=self.model,
            binning=self.binning,
            shape=self.shape,
            readout=self.readout,
            cfa=self.cfa or _CFA,
            pattern_seed=self.pattern_seed,
            noise=noise,
            **MODELS[self.model] | {name: value for name, value in own.items() if value is not None},
        )


class ExposureConfig(Section):
    """How exposure becomes a share of full scale: one number for the whole data set."""

    full_scale: Literal["auto"] | Annotated[float, Range(1e-15, 1e15)] = Field(
        default="auto",
        description="exposure (irradiance x seconds) that fills a pixel; auto finds it from 16 pilot samples",
    )
    illuminance_lux: Annotated[float, Range(1e-6, 1e9, "lux", below="without light there is no image")] | None = Field(
        default=None,
        description="light on a white surface, which has scene radiance 1; sets full_scale by counting photons",
    )

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if self.illuminance_lux is not None and self.full_scale != "auto":
            text = f"got {self.illuminance_lux:g} beside full_scale, which it decides; keep one of the two"
            raise refusal(text, "illuminance_lux", on_key=True)
        return self


NoiseConfig = Annotated[NoNoise | GaussianNoise | PhysicalNoise, Field(discriminator="type")]


class CameraConfig(Section):
    """The lensless camera."""

    mask: MaskConfig | None = Field(default=None, description="the mask; left out when the PSF was measured")
    mask_to_sensor_mm: (
        Annotated[
            float, Range(_NEAREST_MM, 100, "mm", below="the mask must lie in front of the sensor, not on or behind it")
        ]
        | None
    ) = Field(default=None, description="distance in air from the mask to the sensor, millimetres; or give gap")
    gap: Annotated[tuple[GapLayer, ...], Field(min_length=1, max_length=16)] | None = Field(
        default=None, description="the layers from the mask to the sensor, in place of mask_to_sensor_mm"
    )
    substrate: Substrate | None = Field(
        default=None, description="the mask's own plate; on the sensor's side it adds to the distance"
    )
    field_stop_deg: FieldStop | None = Field(
        default=None,
        description="an ideal stop that ends the field of view: the full angle that passes, degrees, or [vertical, "
        "horizontal] ones, or image: right around the image; none when left out, as on a bare sensor",
    )
    sensor: SensorConfig
    illuminant: IlluminantConfig = Field(
        default="D65",
        description="name of the light's spectrum, its file (.csv, .json), an LED {led_nm, fwhm_nm}, or a list of LEDs",
    )
    scene_to_camera: SceneToCamera = Field(
        default="auto",
        description="rows of the matrix from linear sRGB to the camera's channels; auto fits it to their curves and light",
    )
    shutter: ShutterConfig = Field(
        default_factory=lambda: GlobalShutter(0.01), description="when the sensor's rows are open"
    )
    exposure: ExposureConfig = Field(default_factory=ExposureConfig)
    noise: NoiseConfig = Field(default_factory=NoNoise)

    @model_validator(mode="after")
    def _one_distance(self) -> Self:
        if self.gap is None and self.mask_to_sensor_mm is None:
            text = "missing; expected distance in air from the mask to the sensor, millimetres; or give gap: [{mm, n}, ...]"
            raise refusal(text, "mask_to_sensor_mm")
        if self.gap is not None and self.mask_to_sensor_mm is not None:
            text = f"got {len(self.gap)} layers beside mask_to_sensor_mm, which says the same; keep one of the two"
            raise refusal(text, "gap", on_key=True)
        if self.thickness_mm < _NEAREST_MM:
            text = (
                f"got {self.thickness_mm:g} mm in all; expected at least {_NEAREST_MM:g} mm from the mask to the sensor"
            )
            raise refusal(text, "gap")
        return self

    @property
    def thickness_mm(self) -> float:
        """Distance from the mask's modulating surface to the sensor as a ruler measures it, millimetres."""
        layers = self.gap if self.gap is not None else ()
        plate = self.substrate.mm if self.substrate is not None and self.substrate.side == "sensor" else 0.0
        return plate + (self.mask_to_sensor_mm or 0.0) + sum(layer.mm for layer in layers)
