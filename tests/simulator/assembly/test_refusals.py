"""What is refused after a configuration was read has its key and its place; no mutation of one ends in a traceback."""

import copy
import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from simulator.assembly import Assembly
from simulator.config import config_from_dict, dump, load_config
from simulator.dataset import generate
from simulator.errors import InputError
from simulator.presets import preset_names, preset_text

MISTAKES: dict[str, tuple[dict[str, Any], Callable[[Assembly], object], str, str]] = {
    # changes, the part that refuses, the error's path, the line that its place points into
    "a name": ({"camera": {"illuminant": "A9"}}, lambda made: made.geometry, "camera.illuminant", "illuminant: A9"),
    "rows": (
        {"camera": {"scene_to_camera": [[1, 0, 0]]}},
        lambda made: made.camera_colour(("R", "G", "B")),
        "camera.scene_to_camera",
        "  - - 1",
    ),
    "a default": (
        {"psf": {"depths_cm": [4], "wavelengths_per_channel": 1, "accept_error": 1e-3}},
        lambda made: made.psf_stack,
        "psf.oversampling",
        "psf:",
    ),
    "a list": (
        {"camera": {"mask": None}, "psf": {"measured": ["a.tif"], "depths_cm": [5], "frame": "stored", "throughput_mm2": 1}},
        lambda made: made.psf_stack,
        "psf.measured[0]",
        "  - a.tif",
    ),
    "a parameter": (
        {"scene": {"source": "flyingthings3d", "path": "gone", "size": [16, 20]}},
        lambda made: made.source,
        "scene.path",
        "  path: gone",
    ),
    "a plugin": (
        {"scene": {"family": "./plugins.py:boxes", "boxes": 1, "size": [16, 20]}},
        lambda made: made.source,
        "scene './plugins.py:boxes'",
        "scene:",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_refusal_has_its_key_and_its_place(trial, mistake: str) -> None:
    changes, part, key, line = MISTAKES[mistake]
    if mistake == "a plugin":
        trial.plugins.write_text("def boxes(view, *, boxes: int):\n    return 3\n\ncorners = boxes\n")
        changes = changes | {"camera": {"mask": {"design": "pinhole"}}}
    path = trial.write(**changes)
    for config, place in (
        (load_config(path), f"{path}:{1 + path.read_text().splitlines().index(_line(path, line))}:"),
        (config_from_dict(dump(load_config(path)), path.parent), ""),
    ):
        with pytest.raises(InputError) as caught:
            part(Assembly(config))
        assert caught.value.path == key
        assert str(caught.value).startswith(f"{key}: ")
        assert caught.value.place.startswith(place)
        assert bool(caught.value.place) == bool(place)


def _line(path: Path, start: str) -> str:
    return next(line for line in path.read_text().splitlines() if line.strip().startswith(start.strip()))


def test_an_override_is_the_place_of_what_it_set(trial) -> None:
    with pytest.raises(InputError) as caught:
        _ = Assembly(load_config(trial.write(), ["camera.illuminant=A9"])).geometry
    assert caught.value.place == "--set camera.illuminant=A9"


def test_commands_print_the_place(flatlight, trial) -> None:
    path = trial.write()
    (trial.folder / "out").write_text("not a folder")
    code, _, err = flatlight("generate", path)
    assert code == 2
    line = next(n for n, text in enumerate(path.read_text().splitlines(), 1) if text.startswith("  output: "))
    assert err.startswith(f"error: {path}:{line}:11: dataset.output: ")


def test_the_place_of_a_full_disk_is_the_disk(trial, monkeypatch: pytest.MonkeyPatch) -> None:
    from simulator.io.files import StorageError

    def full(*_: object) -> None:
        raise StorageError(Path("/disk"), "cannot be written: full")

    monkeypatch.setattr("simulator.dataset.preparation.write_info", full)
    with pytest.raises(StorageError) as caught:
        generate(trial.write())
    assert caught.value.place == ""


VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 2, 1e-30, -1e30, 1e300, 10**30, 0.5, float("inf"), "", "x", "inf", "auto", "~", "~nobody/x",
    "x" * 300, "../..", "/dev/null", "a\u202eb", "%s", "os:system", "json:dumps", "./nothing.py:f", "none.csv", [], {}, [1],
    ["a"], [None], [[1, 2], [3]], {"a": 1}, {"type": "x"}, {"design": "pinhole"}, [0, 0], [-1, 5], [10**9, 10**9],
]  # fmt: skip
UNKNOWN = ("colour", "size_", "n", "file", "path", "model", "gap", "near_cm", "depths_cm", "substrate", "illuminant")
FACTORS = (-1, 0, 1e-6, 1e-3, 0.5, 1.5, 2, 10, 1e3, 1e6)
VARIANTS: list[tuple[str, Any]] = [  # plausible at first sight
    ("camera.substrate", {"mm": 5, "material": "n-bk7", "side": "scene"}),
    ("camera.substrate", {"mm": 1, "material": "silicon", "side": "sensor"}),
    ("camera.illuminant", "no light"),
    ("camera.illuminant", {"led_nm": 1900, "fwhm_nm": 5}),
    ("camera.sensor.spectral_response", "no camera"),
    ("camera.sensor.spectral_response", "Nikon 5100 (NPL)"),
    ("camera.sensor.readout", "bayer"),
    ("camera.sensor.black_level_dn", 4000),
    ("camera.scene_to_camera", [[1, 0, 0]]),
    ("camera.shutter", {"type": "windows", "function": "./plugins.py:bad_rows"}),
    ("camera.shutter", {"type": "windows", "function": "./plugins.py:leave"}),
    ("camera.shutter", {"type": "rolling", "exposure_ms": 1, "line_time_us": 1e5}),
    ("camera.exposure", {"illuminance_lux": 1e-6}),
    ("psf", {"measured": "gone"}),
    ("psf", {"measured": ["gone.tif"], "depths_cm": [5], "frame": "stored", "throughput_mm2": 1}),
    ("psf.depths_cm", [5, 6, 7]),
    ("scene", {"family": "./plugins.py:three", "size": [64, 64]}),
    ("scene", {"family": "./plugins.py:leave", "size": [64, 64]}),
    ("scene", {"family": "endoscopy", "size": [64, 64]}),
    ("scene", {"source": "film", "path": "none", "size": [64, 64]}),
    ("scene", {"source": "davis", "path": "/dev/null", "size": [64, 64]}),
    ("scene.near_cm", 1e6),
    ("render.bands", {"from_nm": 400, "to_nm": 700, "count": 3}),
]
PLUGINS = """
def bad_rows(rows: int):
    return [[1, 0]] * rows

def three(view):
    return 3

def leave(view):
    raise SystemExit(0)
"""
PARTS: list[Callable[[Assembly], object]] = [
    lambda made: made.geometry,
    lambda made: made.view,
    lambda made: made.sensor,
    lambda made: made.fixed_exposure,
    lambda made: made.shutter,
    lambda made: made.camera_colour(made.response.channels),
    lambda made: made.scene_plugin.bind(made.config.scene.params),
    lambda made: made.source,
]


@cache
def _presets() -> list[Any]:
    return [yaml.safe_load(preset_text(name)) for name in preset_names()]


def _paths(data: Any, prefix: tuple = ()) -> list[tuple]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path for key, value in items for path in [(*prefix, key), *_paths(value, (*prefix, key))]]


def _at(data: Any, path: tuple) -> Any:
    for step in path:
        data = data[step]
    return data


def _mutate(rng: random.Random, data: Any) -> None:
    """Change one thing: a value, a number, a key."""
    if not (found := _paths(data)):
        return
    path = rng.choice(found)
    section, key = _at(data, path[:-1]), path[-1]
    match rng.choice(("value", "value", "number", "number", "drop", "unknown", "misspell", "wrap", "swap")):
        case "number" if isinstance(section[key], int | float) and not isinstance(section[key], bool):
            section[key] = section[key] * rng.choice(FACTORS)
        case "drop":
            del section[key]
        case "unknown" if isinstance(section, dict):
            section[rng.choice(UNKNOWN)] = copy.deepcopy(rng.choice(VALUES))
        case "misspell" if isinstance(key, str):
            section[key[:-1] + "x"] = section.pop(key)
        case "wrap":
            section[key] = [section[key]]
        case "swap":
            section[key] = copy.deepcopy(_at(data, rng.choice(found)))
        case _:
            section[key] = copy.deepcopy(rng.choice(VALUES))


def _vary(rng: random.Random, data: Any) -> None:
    """Put something in that is wrong only together with the rest."""
    name, value = rng.choice(VARIANTS)
    *above, key = name.split(".")
    section = data
    for step in above:
        section = section.setdefault(step, {})
    section[key] = copy.deepcopy(value)
    if name == "psf":
        data["camera"].pop("mask", None)


def _text(rng: random.Random) -> str:
    data = copy.deepcopy(rng.choice(_presets()))
    data["camera"]["mask"]["iterations"] = 2  # a mask that is soon designed is refused as any other
    if rng.random() < 0.5:
        _vary(rng, data)
    else:
        for _ in range(rng.choice((1, 1, 2))):
            _mutate(rng, data)
    lines = yaml.safe_dump(data, sort_keys=False, allow_unicode=True).splitlines()
    if rng.random() < 0.05:
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))  # a key twice
    if rng.random() < 0.05:
        lines[rng.randrange(len(lines))] += rng.choice((":", "&a", " *a", "\t", "]", "'"))
    return "\n".join(lines)


@pytest.mark.parametrize("count", [10, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore")
def test_every_mutation_is_refused_with_its_place_or_works(count: int, tmp_path: Path) -> None:
    rng = random.Random(14)
    (tmp_path / "plugins.py").write_text(PLUGINS)
    path = tmp_path / "mutated.yaml"
    refused, unplaced = [0, 0], []
    for _ in range(count):
        path.write_text(_text(rng), encoding="utf-8")
        try:
            assembly = Assembly(load_config(path), "scalar_rgb")
        except InputError as error:
            refused[0] += 1
            unplaced += [line for line in str(error).splitlines() if not line.startswith(f"{path}:")]
            continue
        for part in PARTS:
            try:
                part(assembly)
            except InputError as error:
                refused[1] += 1
                unplaced += [] if error.place.startswith(f"{path}:") else [f"{error}\n{path.read_text()}"]
    assert not unplaced
    assert min(refused) > count // 10
