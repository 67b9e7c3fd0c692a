"""Loading: file and overrides become a Config, or one clear line per fault with its place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError

from simulator import plugins
from simulator.camera.field import read_angular_response
from simulator.camera.shutter import read_row_shutter
from simulator.camera.surroundings import WORDS
from simulator.config.camera import RowWindows
from simulator.config.schema import Config
from simulator.config.yaml import Origins, apply_overrides, read_yaml
from simulator.errors import InputError
from simulator.io.images import read_light
from simulator.io.store import Place
from simulator.optics.materials import load_material
from simulator.optics.spectra import camera_curves, illuminant_curve
from simulator.text import KeyPath, show
from simulator.validation import Problem, find_problems, validate


class ConfigError(InputError):
    """A refused configuration.

    Attributes:
        problems: one per fault; ``str(error)`` has a line for each, in the order of the file.
    """

    def __init__(self, problems: Sequence[Problem], origins: Origins) -> None:
        self.problems = sorted(problems, key=lambda problem: origins.order(problem.path, problem.on_key))
        places = (origins.label(problem.path, problem.on_key) for problem in self.problems)
        lines = [
            f"{place}: {problem}" if place else str(problem)
            for place, problem in zip(places, self.problems, strict=True)
        ]
        super().__init__("", "\n".join(lines))


def load_config(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Load sim_config.yaml: defaults, then the file, then the overrides.

    Args:
        path: the YAML file; relative paths in it are taken from its folder.
        overrides: ``a.b=c`` each, applied in order; ``c`` is read as YAML (so ``[64, 64]`` is a list), and ``null``
            takes a key away.

    Returns:
        The configuration, with the plugins' defaults filled in.

    Raises:
        InputError: one line ``file:line:column: key: problem`` per fault; for overrides ``--set a.b=c: ...``.
    """
    data, origins = _read(path, overrides)
    return _build(data, Path(path).resolve().parent, origins)


Model = TypeVar("Model", bound=BaseModel)


def load_model(
    model: type[Model] | Callable[[dict[str, Any]], type[Model]],
    path: str | Path,
    overrides: Sequence[str] = (),
    faults: Callable[[Any], Iterable[Problem]] = lambda _: (),
) -> Model:
    """Load any other YAML file: defaults, then the file, then the overrides.

    Args:
        model: what the file must be, strict; or what tells it from the plain data.
        path: the file.
        overrides: see :func:`load_config`.
        faults: finds what is wrong with plain data beside what the model refuses; where there is any, only that is said.

    Raises:
        InputError: see :func:`load_config`.
    """
    data, origins = _read(path, overrides)
    if not (problems := list(faults(data))):
        kind = cast("type[Model]", model if isinstance(model, type) else model(data))
        try:
            return validate(kind, data)
        except ValidationError as error:
            problems = find_problems(error, kind, data)
    raise ConfigError(problems, origins)


def _read(path: str | Path, overrides: Sequence[str]) -> tuple[dict[str, Any], Origins]:
    document = read_yaml(Path(path), str(path))
    if not isinstance(document.data, dict):
        raise InputError(f"{path}:1:1", f"expected a mapping of keys to values, got {show(document.data)}")
    return apply_overrides(document, overrides, str(path))


def config_from_dict(data: Mapping[str, Any], base_dir: Place | None = None, *, check_plugins: bool = True) -> Config:
    """Make a Config from plain data, such as :func:`dump` returns.

    Args:
        data: the configuration.
        base_dir: folder from which relative paths are taken; None is the current one.
        check_plugins: import the mask design and the scenes to check their parameters. False for a data set that
            somebody else made: its code is not run.

    Raises:
        InputError: one line per fault.
    """
    folder = base_dir if isinstance(base_dir, Path) else Path()  # in a store there are no files of a user's
    return _build(dict(data), folder.resolve(), Origins(), check_plugins)


def dump(config: Config) -> dict[str, Any]:
    """Return the canonical form: plain data for JSON with all defaults, infinity as ``"inf"``, paths as written.

    ``config_from_dict(dump(config), config.base_dir) == config``.
    """
    return _without_infinity(config.model_dump(mode="json"))


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of sim_config.yaml, for editors and documentation."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Config.model_json_schema()}


def default_config_text() -> str:
    """Return the text of the sim_config.yaml that comes with flatlight."""
    package = Path(__file__).resolve().parents[1]
    # Inside the package when installed from a wheel, at the top of a checkout.
    for folder in (package, package.parent):
        if (folder / "sim_config.yaml").is_file():
            return (folder / "sim_config.yaml").read_text(encoding="utf-8")
    msg = f"sim_config.yaml is missing from {package}: the installation is incomplete, install flatlight again"
    raise RuntimeError(msg)


def _build(data: dict[str, Any], base_dir: Path, origins: Origins, check_plugins: bool = True) -> Config:
    filled, problems = _fill_plugins(data, base_dir) if check_plugins else (data, [])
    try:
        config = validate(Config, filled)
    except ValidationError as error:
        known = {problem.path for problem in problems}
        problems += [problem for problem in find_problems(error, Config, filled) if problem.path not in known]
    else:
        config._base_dir, config._origins = base_dir, origins
        problems += _file_problems(config) if check_plugins else []
        if not problems:
            return config
    raise ConfigError(problems, origins)


def _fill_plugins(data: dict[str, Any], base_dir: Path) -> tuple[dict[str, Any], list[Problem]]:
    """Check the parameters of mask, shutter and scene, and fill in their defaults."""
    data = dict(data)
    problems: list[Problem] = []
    camera = data.get("camera")
    if isinstance(camera, dict):
        data["camera"] = camera = dict(camera)
        camera["mask"] = _fill(camera.get("mask"), "mask", "design", ("camera", "mask"), base_dir, problems)
        if camera["mask"] is None:
            del camera["mask"]
        shutter = camera.get("shutter")
        if isinstance(shutter, dict) and shutter.get("type") == "windows":
            camera["shutter"] = _fill(shutter, "shutter", "function", ("camera", "shutter"), base_dir, problems)
    for kind, key in (("scene", "family"), ("source", "source")):
        if "scene" in data:
            data["scene"] = _fill(data["scene"], kind, key, ("scene",), base_dir, problems)
    return data, problems


def _fill(section: Any, kind: str, key: str, path: KeyPath, base_dir: Path, problems: list[Problem]) -> Any:
    if not isinstance(section, dict) or not isinstance(section.get(key), str):
        return section  # the schema says what is wrong, if anything is
    other = {"family": "source", "source": "family"}.get(key)
    if other is not None and section.get(other) is not None:
        return section
    own = {name: value for name, value in section.items() if name in plugins.SECTION_KEYS[kind]}
    params = {name: value for name, value in section.items() if name not in own}
    try:
        return own | plugins.resolve(kind, section[key], base_dir).fill(params)
    except plugins.ParameterError as error:
        problems += [Problem((*path, *problem.path), problem.text, problem.on_key) for problem in error.problems]
    except InputError as error:
        problems.append(Problem((*path, key), error.reason))
    return section


def _without_infinity(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_infinity(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_infinity(item) for item in value]
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _file_problems(config: Config) -> list[Problem]:
    """Return what is wrong with the materials, curves and row windows that the camera names: unknown, or unreadable files.

    The mask's ``material`` is looked at where the design has a bare name; a user's own may mean something else by it.
    Curves that are no files are looked up on use, which takes a second.
    """
    camera, base_dir = config.camera, config.base_dir
    materials: dict[KeyPath, Any] = {
        ("camera", "gap", index, "material"): layer.material for index, layer in enumerate(camera.gap or ())
    }
    if camera.substrate is not None:
        materials["camera", "substrate", "material"] = camera.substrate.material
    if camera.mask is not None and ":" not in camera.mask.design:
        materials["camera", "mask", "material"] = camera.mask.params.get("material")
    curves: dict[KeyPath, Any] = {
        ("camera", "sensor", "spectral_response"): camera.sensor.spectral_response,
        ("camera", "illuminant"): camera.illuminant,
    }
    if (captured := getattr(config.psf, "as_captured", None)) is not None:
        curves["psf", "as_captured", "illuminant"] = captured.illuminant
    checks: dict[KeyPath, Callable[[], object]] = {}
    for path, name in materials.items():
        if isinstance(name, str):
            checks[path] = partial(load_material, name, base_dir)
    for path, name in curves.items():
        if isinstance(name, str) and name.lower().endswith((".csv", ".json")):
            checks[path] = partial(illuminant_curve if path[-1] == "illuminant" else camera_curves, name, base_dir)
    if isinstance(camera.shutter, RowWindows) and camera.shutter.file is not None:
        file, sensor = config.resolve_path(camera.shutter.file), camera.sensor
        checks["camera", "shutter", "file"] = partial(read_row_shutter, file, sensor.shape[0], sensor.binning)
    if isinstance(camera.sensor.angular_response, str):
        file = config.resolve_path(camera.sensor.angular_response)
        checks["camera", "sensor", "angular_response"] = partial(read_angular_response, file)
    if config.scene.surroundings not in (None, *WORDS):
        checks["scene", "surroundings"] = partial(read_light, config.resolve_path(config.scene.surroundings))
    problems = []
    for path, check in checks.items():
        try:
            check()
        except InputError as error:
            problems.append(Problem(path, error.reason if error.path == path[-1] else str(error)))
    return problems
