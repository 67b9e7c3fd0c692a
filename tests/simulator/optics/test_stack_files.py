"""PSF stacks on disk: nothing is lost, damage is named."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, stack_folder, write_psf_stack


def make_stack(depths_m: tuple[float, ...] = (0.036, 0.2, np.inf), seed: int = 0) -> PsfStack:
    values = np.random.default_rng(seed).random((len(depths_m), 4, 7, 9), dtype=np.float32)
    depths = np.array(depths_m)
    provenance = {"kind": "computed", "lines": [["R", 6e-7, 1.0]]}
    return PsfStack(values, depths, 19.2e-6, ("nir", "B", "A", "R"), "ab" * 32, provenance)


def test_everything_comes_back(tmp_path: Path) -> None:
    stack = make_stack()
    write_psf_stack(tmp_path / "psf", stack)
    back = read_psf_stack(tmp_path / "psf")
    assert np.array_equal(back.values, stack.values)
    assert back.values.dtype == np.float32
    assert np.array_equal(back.depths_m, stack.depths_m)
    assert (back.pixel_pitch_m, back.channels) == (stack.pixel_pitch_m, stack.channels)
    assert (back.fingerprint, back.provenance) == (stack.fingerprint, stack.provenance)


def test_depth_files_sort_and_say_their_depth(tmp_path: Path) -> None:
    from simulator.io.exr import decode_exr

    depths = tuple(np.linspace(0.04, 0.2, 12))
    write_psf_stack(tmp_path / "psf", make_stack(depths))
    files = sorted((tmp_path / "psf").glob("*.exr"))
    found = [decode_exr(file.read_bytes(), file)[1]["depth_m"] for file in files]
    assert found == list(depths)


def test_a_second_stack_replaces_the_first(tmp_path: Path) -> None:
    write_psf_stack(tmp_path / "psf", make_stack())
    write_psf_stack(tmp_path / "psf", make_stack((0.05,), seed=1))
    assert len(list((tmp_path / "psf").iterdir())) == 2  # no file of the first one is left
    assert np.array_equal(read_psf_stack(tmp_path / "psf").values, make_stack((0.05,), seed=1).values)


def _flip(folder: Path) -> None:
    data = bytearray((folder / "depth_0001.exr").read_bytes())
    data[-20] ^= 1
    (folder / "depth_0001.exr").write_bytes(data)


def _truncate(folder: Path) -> None:
    data = (folder / "depth_0001.exr").read_bytes()
    (folder / "depth_0001.exr").write_bytes(data[: len(data) // 2])


def _mix_up(folder: Path) -> None:
    """Two sound files change places; only the hashes can tell."""
    (folder / "depth_0000.exr").rename(folder / "other")
    (folder / "depth_0001.exr").rename(folder / "depth_0000.exr")
    (folder / "other").rename(folder / "depth_0001.exr")


def _edit(**changes: object) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        content = json.loads((folder / "psf.json").read_text()) | changes
        content = {key: value for key, value in content.items() if value is not None}
        (folder / "psf.json").write_text(json.dumps(content))

    return edit


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (_flip, "depth_0001.exr"),
        (_truncate, "depth_0001.exr"),
        (_mix_up, "depth_0000.exr: "),
        (lambda folder: (folder / "depth_0002.exr").unlink(), "depth_0002.exr"),
        (lambda folder: (folder / "psf.json").unlink(), "/psf: "),
        (lambda folder: (folder / "psf.json").write_text("{"), "psf.json"),
        (lambda folder: (folder / "psf.json").write_text("[]"), "psf.json"),
        (_edit(files=None), "psf.json"),
        (_edit(files={}), "psf.json"),
        (_edit(channels=["nir", "B", "A", "X"]), "psf.json"),
        (_edit(depths_m=[0.1, "far", 2]), "psf.json"),
        (_edit(depths_m=[0.1]), "psf.json"),
        (_edit(pixel_pitch_m=None), "psf.json"),
    ],
)
def test_damage_is_named(tmp_path: Path, damage: Callable[[Path], None], named: str) -> None:
    write_psf_stack(tmp_path / "psf", make_stack())
    damage(tmp_path / "psf")
    with pytest.raises(InputError, match=named):
        read_psf_stack(tmp_path / "psf")


@pytest.mark.parametrize(
    "change", [{"depths_m": [0.108, 0.6, "inf"]}, {"depths_m": [0.036, 0.2, 9.0]}, {"pixel_pitch_m": 20e-6}]
)
def test_depths_and_pitch_are_those_of_the_images(tmp_path: Path, change: dict) -> None:
    write_psf_stack(tmp_path, make_stack())
    path = tmp_path / "psf.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=r"psf\.json: .*depth_000\d\.exr"):
        read_psf_stack(tmp_path)


def test_a_file_name_does_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    write_psf_stack(tmp_path / "psf", make_stack())
    (tmp_path / "psf/depth_0000.exr").rename(tmp_path / "outside.exr")
    content = json.loads((tmp_path / "psf/psf.json").read_text())
    content["files"] = {"../outside.exr": content["files"].pop("depth_0000.exr")} | content["files"]
    (tmp_path / "psf/psf.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"psf\.json: "):
        read_psf_stack(tmp_path / "psf")


def test_nothing_but_a_stack_is_replaced(tmp_path: Path) -> None:
    for place in (tmp_path / "file", tmp_path / "folder" / "thesis.tex"):
        place.parent.mkdir(exist_ok=True)
        place.write_text("years of work")
    for name in ("file", "folder"):
        with pytest.raises(InputError, match=name):
            write_psf_stack(tmp_path / name, make_stack())
    assert (tmp_path / "file").read_text() == (tmp_path / "folder/thesis.tex").read_text() == "years of work"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_where_stacks_lie(tmp_path, monkeypatch) -> None:
    (tmp_path / "set/psf").mkdir(parents=True)
    assert stack_folder(tmp_path / "set") == tmp_path / "set/psf"
    assert stack_folder(tmp_path / "set", captured=True) == tmp_path / "set/psf_captured"
    assert stack_folder(tmp_path / "stack", captured=True) == tmp_path / "stack_captured"
    monkeypatch.chdir(tmp_path)
    assert stack_folder(type(tmp_path)(), captured=True).name == f"{tmp_path.name}_captured"
