"""The fingerprint changes with everything that decides a sample's bytes, and with nothing else."""

import copy
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.dataset.fingerprint import build_fingerprint, difference, distinct_names, package_versions
from simulator.errors import InputError

CONFIG = {
    "name": "a",
    "seed": 7,
    "camera": {"noise": {"type": "gaussian", "psnr_db": 40.0}, "shape": (456, 684)},
    "psf": {"far_cm": float("inf")},
    "dataset": {"output": Path("out"), "train": 48, "validation": 8, "test": 8, "workers": "auto", "engine": "local"},
}


def changed(*path: object) -> dict:
    """A copy of the configuration with the value at ``path[:-1]`` replaced by ``path[-1]``."""
    config = copy.deepcopy(CONFIG)
    inner: Any = config
    for key in path[:-2]:
        inner = inner[key]
    inner[path[-2]] = path[-1]
    return config


def test_free_settings_do_not_count() -> None:
    base, _ = build_fingerprint(CONFIG, "llvm_ad_rgb")
    assert len(base) == 64
    free = {
        "output": "x",
        "share_videos": True,
        "train": 9,
        "validation": 0,
        "test": 1,
        "workers": 2,
        "engine": "inline",
    }
    for key, value in free.items():
        assert build_fingerprint(changed("dataset", key, value), "llvm_ad_rgb")[0] == base
    assert build_fingerprint(changed("name", "b"), "llvm_ad_rgb")[0] == base
    assert build_fingerprint(dict(reversed(CONFIG.items())), "llvm_ad_rgb")[0] == base
    assert build_fingerprint(changed("camera", "shape", [456, 684]), "llvm_ad_rgb")[0] == base


def test_everything_else_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [("seed", 0), ("camera", "noise", "psnr_db", 30.0), ("psf", "far_cm", 20.0)]
    places += [("dataset", "future_option", True), ("dataset", "slivers", 10), ("dataset", "ground_truth", "frames")]
    configs = [CONFIG, *(changed(*place) for place in (*places, ("dataset", "global_measurements", True)))]
    fingerprints = {build_fingerprint(config, "llvm_ad_rgb")[0] for config in configs}
    fingerprints.add(build_fingerprint(CONFIG, "scalar_rgb")[0])
    monkeypatch.setattr("simulator.dataset.fingerprint.package_versions", lambda: {"numpy": "0.0"})
    fingerprints.add(build_fingerprint(CONFIG, "llvm_ad_rgb")[0])
    assert len(fingerprints) == 10


def test_input_files_count_by_content_not_by_place(tmp_path: Path) -> None:
    for folder, content in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "psf.tif").write_bytes(content)
    a, b, c = (tmp_path / folder / "psf.tif" for folder in "abc")
    one = {path: build_fingerprint(CONFIG, "x", [path])[0] for path in (a, b, c)}
    assert one[a] == one[b] != one[c]
    assert build_fingerprint(CONFIG, "x", [a, c])[0] != build_fingerprint(CONFIG, "x", [c, a])[0]
    assert list(build_fingerprint(CONFIG, "x", [a, c])[1]["inputs"]) == ["psf.tif", "psf.tif#2"]
    with pytest.raises(InputError, match="gone: "):
        build_fingerprint(CONFIG, "x", [tmp_path / "gone"])


def test_versions_are_those_installed() -> None:
    versions = package_versions()
    assert versions["numpy"] == np.__version__
    assert {"flatlight", "mitsuba", "drjit", "OpenEXR", "pillow", "trimesh"} < set(versions)
    assert "absent" not in versions.values()


def test_the_denoiser_counts_where_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its version changes what it makes of a picture, and nothing of pictures that it never sees."""
    version = metadata.version
    found = {}
    for number in ("1.0", "2.0"):
        monkeypatch.setattr(metadata, "version", lambda name, n=number: n if name == "pyoidn" else version(name))
        for denoise in (True, False):
            config = CONFIG | {"render": {"backend": "auto", "denoise": denoise}}
            found[denoise, number], parts = build_fingerprint(config, "llvm_ad_rgb")
            assert parts["versions"].get("pyoidn") == (number if denoise else None)
        assert build_fingerprint(CONFIG, "llvm_ad_rgb")[1]["versions"].get("pyoidn") is None
    assert found[True, "1.0"] != found[True, "2.0"]
    assert found[False, "1.0"] == found[False, "2.0"]
    assert found[True, "1.0"] != found[False, "1.0"]


def test_what_a_source_comes_through_counts_where_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same for films' decoder and for OpenCV, which is installed under one of four names."""
    version = metadata.version
    installed = {"av": "1.0", "opencv-contrib-python": "4.0"}

    def look_up(name: str) -> str:
        if name in ("av", "torch") or name.startswith("opencv"):
            if name not in installed:
                raise metadata.PackageNotFoundError(name)
            return installed[name]
        return version(name)

    monkeypatch.setattr(metadata, "version", look_up)
    names = ("av", "opencv-python-headless", "torch")
    first, parts = build_fingerprint(CONFIG, "none", packages=names)
    plain_one, plain_parts = build_fingerprint(CONFIG, "none")
    added = {key: value for key, value in parts["versions"].items() if key not in plain_parts["versions"]}
    assert added == installed | {"torch": "absent"}
    for changed_name in ("av", "opencv-contrib-python"):
        monkeypatch.setitem(installed, changed_name, "9.9")
        second, new = build_fingerprint(CONFIG, "none", packages=names)
        assert second != first
        assert f"versions.{changed_name}: " in difference(parts, new)
        assert build_fingerprint(CONFIG, "none")[0] == plain_one
        first, parts = second, new


class CountingName(str):
    """A name that counts how often a number is put behind it."""

    __slots__ = ()
    numbered = 0

    def __format__(self, spec: str) -> str:
        CountingName.numbered += 1
        return super().__format__(spec)


def test_files_of_one_name_are_numbered_without_going_through_all_numbers() -> None:
    """Frames are called alike in every video: 40 000 files must not take 10^9 steps."""
    names = [CountingName(name) for _ in range(300) for name in ("00000.jpg", "00005.jpg")]
    assert len(set(distinct_names(names))) == 600
    assert CountingName.numbered == 598


@given(st.lists(st.sampled_from(["a", "a#2", "a#3", "a#2#2", "b"])))
def test_numbers_are_the_first_free_ones(names: list[str]) -> None:
    """Fingerprints of data sets on disk stay: the names are those of a search from 2 on, every time."""
    expected: list[str] = []
    for name in names:
        numbered = (f"{name}#{number}" for number in range(2, 100))
        expected.append(name if name not in expected else next(n for n in numbered if n not in expected))
    assert list(distinct_names(names)) == expected


def test_differences_are_readable(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"1")
    _, old = build_fingerprint(CONFIG, "llvm_ad_rgb", [tmp_path / "x"])
    (tmp_path / "x").write_bytes(b"2")
    _, new = build_fingerprint(changed("camera", "noise", {"type": "none"}), "scalar_rgb", [tmp_path / "x"])
    assert difference(old, new).splitlines() == [
        "backend: llvm_ad_rgb -> scalar_rgb",
        "camera.noise.psnr_db: 40.0 -> (absent)",
        "camera.noise.type: gaussian -> none",
        "inputs.x: 6b86b273ff34 -> d4735e3a265e",  # the SHA-256 of "1" and of "2"
    ]
    assert difference(old, old) == ""
    assert difference({"config": {"a": 1}}, {"config": {"a": 1.0}}) == "a: 1 -> 1.0"
    assert difference({"config": {"a": "1"}}, {"config": {"a": 1}}) == "a: '1' -> 1"
    assert difference({"config": {"gap": [{"mm": 1}, {"mm": 2}]}}, {"config": {"gap": [{"mm": 1}]}}) == (
        "gap.1.mm: 2 -> (absent)"
    )
