"""No cached result outlives a change of the code that made it: all of our code that runs is behind the key."""

import sys
import threading
from pathlib import Path
from pkgutil import iter_modules

import pytest

import scenes
import simulator
from psf_library import designs
from simulator import assembly, captured_psf
from simulator.assembly import Assembly
from simulator.captured_psf import captured_stack
from simulator.config import load_config
from simulator.dataset.fingerprint import PACKAGES
from simulator.design import load
from simulator.io import cache

TOP = Path(simulator.__file__).parents[1]
OURS = [f"{TOP / name}/" for name in ("simulator", "scenes", "psf_library", "learning")]
MASK = {"design": "phlatcam", "width_mm": 0.4, "iterations": 1}
LIT = {"exposure": {"illuminance_lux": 100}}


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, set[Path]]:
    """Return a mapping of kinds of cached results to our files whose code ran for them, but which no key covers."""
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "cache"))
    missing: dict[str, set[Path]] = {}
    covered: list[set[Path]] = []

    def digest(*origins: str | Path) -> str:
        covered.append(set(cache._dependencies(origins)[0]))
        return cache.code_digest(*origins)

    def cached(kind: str, key: str, compute) -> cache.Entry:
        names: set[str] = set()

        def note(frame, event: str, _) -> None:
            names.add(frame.f_code.co_filename)

        before = sys.getprofile()
        threading.setprofile(note)
        sys.setprofile(note)
        try:
            entry = compute()
        finally:
            sys.setprofile(before)
            threading.setprofile(None)
        own = Path(compute.__code__.co_filename)  # it lays the arguments out
        files = {Path(name) for name in names if any(name.startswith(package) for package in OURS)} - {own}
        missing[kind] = files - covered[-1]
        assert files & covered[-1], "the notes are empty"
        return entry

    for module in (assembly, captured_psf, load):
        monkeypatch.setattr(module, "cached", cached)
        monkeypatch.setattr(module, "code_digest", digest)
    return missing


@pytest.mark.slow  # each call is watched
def test_all_code_that_runs_is_behind_the_key(ran: dict[str, set[Path]], trial) -> None:
    psf = {"depths_cm": [5], "wavelengths_per_channel": 1, "accept_error": 1, "as_captured": {}}
    captured_stack(Assembly(load_config(trial.write(camera={"mask": MASK}, psf=psf))))
    assert ran == {kind: set() for kind in ("masks", "response", "psf", "budget", "captured")}


@pytest.mark.slow
def test_all_code_that_runs_is_behind_the_keys_of_light(ran: dict[str, set[Path]], trial) -> None:
    built = Assembly(load_config(trial.write(camera=LIT)))
    _ = built.response, built.sensor, built.camera_colour(("R", "G", "B"))
    assert ran == {kind: set() for kind in ("response", "photometry", "colour")}


@pytest.mark.slow
def test_all_code_that_runs_is_behind_the_key_of_a_full_check(ran: dict[str, set[Path]], trial) -> None:
    _ = Assembly(load_config(trial.write(psf={"depths_cm": [5], "check": "full"}))).checked_stack
    assert ran["check"] == set()


def test_every_package_behind_a_sample_is_in_the_fingerprint() -> None:
    """What our scenes, designs and recipe import has its version in a data set's fingerprint, or cannot change a value."""
    names = [
        f"{package.__name__}.{module.name}"
        for package in (scenes, designs)
        for module in iter_modules(package.__path__)
    ]
    _, packages = cache._dependencies(("simulator.dataset.recipe", *names))
    no_value = {
        "platformdirs",
        "pydantic",
        "pydantic_core",
        "rawpy",
        "ray",
        "yaml",
        "torch",
    }  # folders, checks, files that are named by their hash, where it is made, and what NumPy replaces
    known = {name.lower().replace("-", "_") for name in PACKAGES}
    assert {cache._DISTRIBUTIONS.get(name, name).lower().replace("-", "_") for name in packages - no_value} <= known


def test_an_import_inside_a_function_counts() -> None:
    files, packages = cache._dependencies(("simulator.io.images",))
    assert TOP / "simulator" / "io" / "exr.py" in files
    assert {"numpy", "PIL", "tifffile", "OpenEXR"} <= packages


def test_a_file_of_one_s_own_counts_with_what_it_imports_of_ours(tmp_path: Path) -> None:
    file = tmp_path / "design.py"
    file.write_text("def mask():\n    from simulator.design.fabrication import quantise\n")
    files, _ = cache._dependencies((file,))
    assert {file, TOP / "simulator/design/fabrication.py", TOP / "simulator/optics/mask.py"} <= set(files)
    before = cache.code_digest(file)
    file.write_text(file.read_text() + "# changed\n")
    assert cache.code_digest(file) != before
