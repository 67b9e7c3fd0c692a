"""The schema of sim_config.yaml: the whole, and the smaller sections. Camera and PSF have their own files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from simulator.config.camera import CameraConfig, PhysicalNoise, Shape
from simulator.config.psf import ComputedPsf, PsfConfig
from simulator.config.yaml import Origins
from simulator.errors import InputError
from simulator.io.files import StorageError, expanded
from simulator.settings import Range
from simulator.text import KeyPath, dotted, key_path, nearest, show
from simulator.validation import OutputText, PluginSection, Section, refusal

Count = Annotated[int, Range(0, 100_000_000, below="a number of samples is not negative")]


class ForwardConfig(Section):
    """How scene light becomes irradiance on the sensor."""

    depth_assignment: Literal["linear", "nearest"] = Field(
        default="linear",
        description="share a pixel between its two planes (linear in disparity), or give it to the nearest",
    )
    boundary: Literal["linear", "circular"] = Field(
        default="linear", description="linear convolution with crop (real), or circular (for closed-form inversions)"
    )
    vignetting: bool = Field(default=True, description="the cos^4 fall-off towards the edge of the field")
    time: Literal["integral", "mean"] = Field(
        default="integral",
        description="what a pixel adds up while its row is open: exposure (irradiance x seconds), or divided by the row's "
        "exposure time, the mean irradiance",
    )
    max_clamped: Annotated[float, Range(0, 1)] = Field(
        default=0.01, description="share of scene pixels outside the planes' range that is accepted"
    )


class SceneConfig(PluginSection):
    """The scenes: a rendered family or an imported source, and its parameters as further keys."""

    family: str | None = Field(default=None, description="a family's name, ./file.py:name or package.module:name")
    source: str | None = Field(
        default=None, description="an imported source's name, ./file.py:name or package.module:name"
    )
    size: Shape = Field(description="rows and columns of the scene, in binned sensor pixels")
    margin: Literal["auto"] | Annotated[int, Range(0, 4096)] = Field(
        default=0,
        description="pixels beside each edge of the image from which light is simulated, too, outside of the ground truth; "
        "auto: up to the field stop, or until less than 2 % of a uniform half space's light is left out",
    )
    margin_deg: Annotated[float, Range(0, 80, "deg (degrees)")] | None = Field(
        default=None, description="the same as an angle beyond the image's edges, degrees"
    )
    surroundings: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="what shines in the margin of images that say nothing of it: black, continue (the image goes on, "
        "mirrored), own (samples of a data set know it), or an image file of the whole field",
    )
    near_cm: Annotated[float, Range(0.01, 1e7, "cm")] | None = Field(
        default=None, description="nearest depth of the scenes, centimetres; the PSF's nearest plane when left out"
    )
    far_cm: Annotated[float, Range(0.01, 1e7, "cm", infinite=True)] | None = Field(
        default=None, description="farthest depth of the scenes, centimetres; the PSF's farthest plane when left out"
    )

    @model_validator(mode="after")
    def _near_before_far(self) -> Self:
        if self.near_cm is not None and self.far_cm is not None and self.near_cm >= self.far_cm:
            text = f"got {self.near_cm:g}, which is not nearer than far_cm = {self.far_cm:g}; swap them?"
            raise refusal(text, "near_cm")
        return self

    @property
    def has_margin(self) -> bool:
        """Whether light from beside the image is asked for."""
        return self.margin != 0 or bool(self.margin_deg)

    @model_validator(mode="after")
    def _known_surroundings(self) -> Self:
        if self.margin_deg is not None and self.margin != 0:
            text = f"got {self.margin_deg:g} beside margin, which says the same in pixels; keep one of the two"
            raise refusal(text, "margin_deg", on_key=True)
        if self.surroundings is not None and not self.has_margin:
            text = f"got {self.surroundings!r}, but there is no margin to be filled; add margin: auto, or leave it out"
            raise refusal(text, "surroundings", on_key=True)
        if self.source is not None and self.has_margin and self.surroundings is None:
            text = (
                "missing; imported images end at their edges, and the margin asks for what is beside them; give black, "
                "continue (the image goes on, mirrored), own (samples know it) or an image file, or leave the margin out"
            )
            raise refusal(text, "surroundings")
        return self

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.family is not None and self.source is not None:
            text = f"got source {self.source!r} beside family {self.family!r}; scenes come from one of them, keep one"
            raise refusal(text, "source")
        if self.family is None and self.source is None:
            for key in self.params:
                if hint := nearest(key, ["family", "source"]):
                    text = f"unknown key, got {show(self.params[key])}{hint}"
                    raise refusal(text, key, on_key=True)
            text = "needs family: NAME (rendered scenes) or source: NAME (an imported data set), got neither"
            raise refusal(text)
        return self


class RayConfig(Section):
    """Which Ray cluster makes the samples, and what each of them needs of a node beside one CPU."""

    address: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="head node, such as 10.0.0.1:6379; left out: $RAY_ADDRESS, or a cluster of this machine alone",
    )
    memory_gb: Annotated[float, Range(0.001, 10_000, "GB")] | None = Field(
        default=None, description="memory that Ray sets aside for a sample, gigabytes: a node takes no more than fit"
    )
    resources: dict[str, Annotated[float, Range(0, 1e6)]] = Field(
        default_factory=dict, description="further resources of a node that a sample needs, by the cluster's names"
    )


class DatasetConfig(Section):
    """What is written, how much of it, and by how many workers."""

    output: OutputText = Field(description="folder of the data set, or a place in an object store: s3://BUCKET/FOLDER")
    train: Count = Field(default=0, description="number of training samples")
    validation: Count = Field(default=0, description="number of validation samples")
    test: Count = Field(default=0, description="number of test samples")
    workers: Literal["auto"] | Annotated[int, Range(1, 1024)] = Field(
        default="auto",
        description="worker processes; auto takes one per core, with engine: ray one per core of the cluster",
    )
    engine: Literal["inline", "local", "ray"] = Field(
        default="local", description="this process (inline), worker processes (local), or a Ray cluster (ray)"
    )
    ray: RayConfig = Field(default_factory=RayConfig, description="for engine: ray")
    timeout_s: Annotated[float, Range(1, 1e7, "s")] = Field(
        default=3600.0,
        description="seconds after which a sample that hangs is stopped and tried again, three times in all; with engine "
        "inline nothing stops it",
    )

    slivers: Annotated[int, Range(1, 10_000, below="a capture is one sliver at least")] | None = Field(
        default=None,
        description="parts in time that a capture is taken apart into; null makes one of every frame that the shutter sees",
    )
    ground_truth: Literal["slivers", "frames"] = Field(
        default="slivers", description="the mean image of each sliver's frames, or every frame that the shutter sees"
    )
    global_measurements: bool = Field(
        default=False, description="store what a global shutter would have measured of each sliver, too"
    )
    share_videos: bool = Field(
        default=False,
        description="let splits show the same source videos where there are too few: for a trial, not for results",
    )

    @model_validator(mode="after")
    def _a_truth_per_measurement(self) -> Self:
        if self.global_measurements and self.ground_truth == "frames":
            text = (
                "got true beside ground_truth: frames, but each global measurement belongs to a sliver; keep one of the two "
                "(slivers: null makes every frame a sliver)"
            )
            raise refusal(text, "global_measurements")
        return self

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if self.train + self.validation + self.test == 0:
            text = "train, validation and test are all 0: the data set would be empty; give at least one a count"
            raise refusal(text)
        return self


Nanometres = Annotated[float, Range(360, 830, "nm")]


class BandsConfig(Section):
    """Wavelength bands: equal ones (from_nm, to_nm, count), or any by their edges."""

    from_nm: Nanometres | None = Field(default=None, description="where the first of equal bands begins")
    to_nm: Nanometres | None = Field(default=None, description="where the last of equal bands ends")
    count: Annotated[int, Range(1, 100)] | None = Field(default=None, description="how many equal bands")
    edges_nm: tuple[Nanometres, ...] | None = Field(
        default=None, description="edges of contiguous bands, one more than bands", min_length=2, max_length=101
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        equal = (self.from_nm, self.to_nm, self.count)
        if (self.edges_nm is None) == (None in equal) or (self.edges_nm is not None and equal != (None, None, None)):
            text = "needs from_nm, to_nm and count, or edges_nm alone"
            raise refusal(text)
        edges = self.edges
        if any(second - first < 1 for first, second in pairwise(edges)):
            text = f"got edges {[round(edge, 3) for edge in edges]}, expected them to increase by at least 1 nm"
            raise refusal(text, "edges_nm" if self.edges_nm is not None else "to_nm")
        return self

    @property
    def edges(self) -> tuple[float, ...]:
        """The bands' edges in nanometres."""
        if self.edges_nm is not None:
            return self.edges_nm
        assert self.from_nm is not None
        assert self.to_nm is not None
        assert self.count is not None
        step = (self.to_nm - self.from_nm) / self.count
        return (*(self.from_nm + step * number for number in range(self.count)), self.to_nm)


class RenderConfig(Section):
    """How scenes are rendered."""

    backend: Literal["auto", "llvm", "scalar"] = Field(
        default="auto", description="Mitsuba's backend; auto takes llvm where it was proven to work, else scalar"
    )
    outputs: tuple[Literal["shape_id", "normal", "albedo", "motion", "hidden"], ...] = Field(
        default=(), description="what is stored of each pixel beside colour and depth; motion needs clips"
    )
    hidden_layers: Annotated[int, Range(1, 8)] = Field(
        default=1, description="how many layers of surfaces behind the image the output hidden holds"
    )
    denoise: bool = Field(
        default=False,
        description="pass images through Open Image Denoise: less noise, but biased; pip install 'flatlight[denoise]'",
    )

    bands: BandsConfig | None = Field(
        default=None,
        description="wavelength bands that are stored beside RGB: spectral rendering, 16 of them cost a third more",
    )


class Config(Section):
    """A camera, its scenes and the data set that they make.

    Relative paths are kept as written; :meth:`resolve_path` takes them from the YAML file's folder.
    """

    name: str = Field(description="name of the data set", min_length=1, max_length=200)
    seed: Annotated[int, Range(0, 2**63 - 1, below="a seed is not negative; 0 is a seed like any other")] = Field(
        default=0, description="root of all random streams"
    )
    camera: CameraConfig
    psf: PsfConfig
    forward: ForwardConfig = Field(default_factory=ForwardConfig)
    scene: SceneConfig
    dataset: DatasetConfig
    render: RenderConfig = Field(default_factory=RenderConfig)
    _base_dir: Path = PrivateAttr(default_factory=Path.cwd)
    _origins: Origins = PrivateAttr(default_factory=Origins)

    @property
    def base_dir(self) -> Path:
        """The YAML file's folder (absolute); no part of the dump."""
        return self._base_dir

    def resolve_path(self, text: str | Path) -> Path:
        """Return a path of this configuration as an absolute one."""
        return expanded(text, self._base_dir)

    @contextmanager
    def refusals(self, *sections: str) -> Iterator[None]:
        """Name the key, and its place in the file, in what is refused inside by a part that this configuration made.

        Args:
            sections: dotted, where the part's arguments may be keys; what is no key gets the place of the first one.
        """
        try:
            yield
        except InputError as error:
            if not error.place and not isinstance(error, StorageError):
                self._place(error, sections)
            raise

    def _place(self, error: InputError, sections: tuple[str, ...]) -> None:
        path = key_path(error.path)
        if path[:1] and path[0] in type(self).model_fields:
            error.place = self._origins.label(path, on_key=False)
            return
        for section in map(key_path, sections):
            if path and self._holds((*section, *path)):
                error.path, error.place = (
                    dotted((*section, *path)),
                    self._origins.label((*section, *path), on_key=False),
                )
                return
        if sections:
            error.place = self._origins.label(key_path(sections[0]), on_key=True)

    def _holds(self, path: KeyPath) -> bool:
        value: Any = self.model_dump(mode="json")
        try:
            for step in path:
                value = value[step]
        except (KeyError, IndexError, TypeError):
            return False
        return True

    @model_validator(mode="after")
    def _mask_or_measurement(self) -> Self:
        if isinstance(self.psf, ComputedPsf):
            if self.camera.mask is None:
                text = "missing; a PSF is computed from a mask: give mask: {design: ...}, or psf: {measured: [...]}"
                raise refusal(text, "camera", "mask")
            nearest, distance = self.psf.nearest_cm, self.camera.thickness_mm
            if nearest * 10 < distance:
                text = (
                    f"got {nearest:g} cm, nearer to the mask than the sensor is ({distance:g} mm), where the PSF would "
                    "be magnified more than twice; was the number meant in another unit?"
                )
                raise refusal(text, "psf", *(["near_cm"] if self.psf.depths_cm is None else ["depths_cm", 0]))
            plate = self.camera.substrate
            if plate is not None and plate.side == "scene" and nearest * 10 <= plate.mm:
                text = (
                    f"got {plate.mm:g} mm in front of the mask, but the psf's nearest depth, {nearest:g} cm from the mask's "
                    "modulating surface, lies inside it"
                )
                raise refusal(text, "camera", "substrate", "mm")
        elif self.camera.mask is not None:
            text = f"got {self.camera.mask.design!r}, but psf.measured says that the PSF was measured; keep one of them"
            raise refusal(text, "camera", "mask")
        return self

    @model_validator(mode="after")
    def _photons_come_from_exposures(self) -> Self:
        counts = "camera.exposure.illuminance_lux needs" if self.camera.exposure.illuminance_lux is not None else ""
        if not counts and isinstance(self.camera.noise, PhysicalNoise):
            counts = "camera.noise: physical needs"
        if self.forward.time == "mean" and counts:
            text = (
                f"got mean, which takes the exposure time out of the measurement, but {counts} it to count each row's "
                "photons; use time: integral"
            )
            raise refusal(text, "forward", "time")
        return self

    @model_validator(mode="after")
    def _no_margin_goes_round(self) -> Self:
        if self.forward.boundary == "circular" and self.scene.has_margin:
            text = (
                "got circular, under which light that misses the sensor comes back; it has no meaning beside a margin"
            )
            raise refusal(f"{text}: use linear, or leave the scene's margin out", "forward", "boundary")
        return self

    @model_validator(mode="after")
    def _scene_fits_sensor(self) -> Self:
        for axis, name in enumerate(("rows", "columns")):
            scene, sensor = self.scene.size[axis], self.camera.sensor.shape[axis]
            if scene > sensor:
                text = (
                    f"got {scene} {name} on a sensor of {sensor} (camera.sensor.shape, binned pixels); a scene pixel "
                    "is a sensor pixel, so the scene must not be larger"
                )
                raise refusal(text, "scene", "size", axis)
            if (sensor - scene) % 2:
                text = (
                    f"got {scene} {name} on a sensor of {sensor} (camera.sensor.shape): one is even, one odd, so their "
                    "centres lie half a pixel apart; change one of them by 1"
                )
                raise refusal(text, "scene", "size", axis)
        return self
