"""Family "files": which file becomes which sample, where models stand, pictures pixel by pixel, faults in words."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenes.files import OwnFiles, files
from simulator.colour import srgb_to_linear
from simulator.errors import InputError
from simulator.io.images import area_mean
from simulator.plugins import ParameterError, resolve
from simulator.render import Renderer
from simulator.types import FARTHEST_M, SceneSource, View

VIEW = View((12, 16), 160e-6, 1.9e-3, 0.036, 0.2)
SCENE = '<scene version="3.0.0"><emitter type="constant"/>'
SCENE += '<shape type="sphere"><point name="center" x="0" y="0" z="4"/></shape>'
SCENE += '<shape type="obj"><string name="filename" value="tetra.obj"/>'
SCENE += '<transform name="to_world"><translate x="2" z="5"/></transform></shape></scene>'
TETRA = "v 1 1 1\nv -1 -1 1\nv -1 1 -1\nv 1 -1 -1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def source(path: Path | list[Path], *outputs: str, view: View = VIEW, **keywords: Any) -> OwnFiles:
    arguments: dict[str, Any] = {"samples_per_pixel": 1} | keywords
    return files(view, path=path, renderer=Renderer("scalar_rgb", outputs), **arguments)


def tetra(folder: Path) -> Path:
    (folder / "tetra.obj").write_text(TETRA)
    return folder / "tetra.obj"


def picture(path: Path, shape: tuple[int, int] = VIEW.shape, seed: int = 0) -> np.ndarray:
    codes = np.random.default_rng(seed).integers(0, 256, (*shape, 3), dtype=np.uint8)
    Image.fromarray(codes).save(path)
    return codes


def test_a_folder_gives_its_scenes_and_models_in_order(tmp_path: Path) -> None:
    tetra(tmp_path)
    (tmp_path / "a.xml").write_text(SCENE)
    picture(tmp_path / "skin.png")
    (tmp_path / "notes.txt").write_text("not shown")
    family = source(tmp_path)
    assert isinstance(family, SceneSource)
    assert [path.name for path in family.paths] == ["a.xml", "tetra.obj"]
    assert list(family.inputs) == [tmp_path / "a.xml", tmp_path / "tetra.obj"]
    assert not hasattr(family, "__len__"), "random poses never end"
    shown = [family.clip(index, np.random.default_rng(1)).source["file"] for index in (0, 1, 2, -1)]
    assert shown == ["a.xml", "tetra.obj", "a.xml", "tetra.obj"]
    (tmp_path / "pictures").mkdir()
    for name in ("b.png", "a.jpg"):
        picture(tmp_path / "pictures" / name)
    assert [path.name for path in source(tmp_path / "pictures").paths] == ["a.jpg", "b.png"]
    finite = source([tmp_path / "tetra.obj"], pose="upright")
    assert isinstance(finite, OwnFiles)
    assert len(finite) == 1


def test_the_same_index_and_generator_give_the_same_bytes(tmp_path: Path) -> None:
    family = source(tetra(tmp_path), light="varied", samples_per_pixel=2)
    copy = pickle.loads(pickle.dumps(family))
    first, second = (one.clip(0, np.random.default_rng(3)) for one in (family, copy))
    other = family.clip(0, np.random.default_rng(4))
    assert first.rgb.tobytes() == second.rgb.tobytes()
    assert first.depth_m.tobytes() == second.depth_m.tobytes()
    assert not np.array_equal(first.depth_m, other.depth_m)
    assert len(pickle.dumps(family)) < 5000
    json.dumps(first.source)


@pytest.mark.parametrize("background", ["wall", "black"])
@pytest.mark.parametrize("far_m", [0.2, 0.05, np.inf])
def test_models_stand_between_near_and_far_and_wholly_in_view(tmp_path: Path, background: str, far_m: float) -> None:
    view = View((24, 32), 80e-6, 1.9e-3, 0.036, far_m)
    corners = np.array([line.split()[1:] for line in TETRA.splitlines() if line[0] == "v"], float) * (1, -1, -1)
    family = source(tetra(tmp_path), "shape_id", background=background, view=view)
    sizes = []
    for seed in range(6):
        clip = family.clip(0, np.random.default_rng(seed))
        facts = clip.source
        placed = facts["centre_m"] + facts["metres_per_unit"] * corners @ np.array(facts["rotation"]).T
        assert placed[:, 2].min() > view.near_m
        assert placed[:, 2].max() < (far_m if np.isfinite(far_m) else 50 * view.near_m)
        across = np.abs(placed[:, :2] / placed[:, 2:])
        assert np.all(across < (view.tan_half_width, view.tan_half_height))
        assert clip.depth_m.min() > view.near_m
        assert clip.depth_m.max() <= min(far_m, FARTHEST_M)
        assert clip.valid.all() == (background == "wall")
        sizes.append(np.count_nonzero(clip.extras["shape_id"] == (1 if background == "wall" else 0)))
    # Its ball has 0.6 to 0.97 of the largest radius, which is 10.7 pixels by the view and 3.6 by the thin range of depths;
    # a tetrahedron covers at least 30 % of its ball.
    assert min(sizes) > (35 if far_m > 0.1 else 3)
    assert max(sizes) > (70 if far_m > 0.1 else 7)
    assert len(set(sizes)) > 3


def test_an_upright_model_stands_in_the_middle_at_its_true_size(tmp_path: Path) -> None:
    clip = source(tetra(tmp_path), pose="upright", length_of_unit_cm=1.5, background="black").clip(
        0, np.random.default_rng(0)
    )
    assert clip.source["metres_per_unit"] == pytest.approx(0.015, rel=1e-12)
    np.testing.assert_array_equal(clip.source["rotation"], np.eye(3))
    np.testing.assert_array_equal(clip.source["centre_m"][:2], 0)
    outline = clip.valid[0][:, 2:14]
    np.testing.assert_array_equal(outline, outline.T)
    assert 12 < outline.sum() == clip.valid.sum()
    # the nearest edge, z = 1 in the file, joins the upper right to the lower left corner
    nearest = clip.depth_m[clip.valid].min()
    assert nearest == pytest.approx(clip.source["centre_m"][2] - 0.015, rel=0.02)
    front = clip.depth_m[0] < nearest * 1.02
    rows, columns = np.nonzero(front)
    assert np.corrcoef(rows, columns)[0, 1] < -0.8


def test_light_of_the_studio_is_the_same_every_time_and_varied_is_not(tmp_path: Path) -> None:
    def mean(light: str, seed: int) -> float:
        family = source(tetra(tmp_path), pose="upright", background="black", light=light, samples_per_pixel=64)
        clip = family.clip(0, np.random.default_rng(seed))
        return float(clip.rgb[clip.valid].mean())

    studio = [mean("studio", seed) for seed in range(3)]
    assert np.ptp(studio) < 0.03 * np.mean(studio)  # 64 paths per pixel, some 60 pixels
    assert 0.2 < np.mean(studio) < 1.0, "a reflectance of 0.5 is well exposed"
    varied = [mean("varied", seed) for seed in range(3)]
    assert np.ptp(varied) > 0.1 * np.mean(varied)


def test_a_picture_fills_the_view_pixel_by_pixel(tmp_path: Path) -> None:
    codes = picture(tmp_path / "a.png")
    family = source(tmp_path / "a.png", "shape_id", "normal", plane_cm=7.5)
    assert len(family) == 1
    clip = family.clip(0, np.random.default_rng(0))
    np.testing.assert_allclose(clip.rgb[0], srgb_to_linear(codes / 255), rtol=1e-6)
    assert np.all(clip.depth_m == np.float32(0.075))
    assert clip.valid.all()
    assert not clip.extras["shape_id"].any()
    np.testing.assert_array_equal(clip.extras["normal"][0, 3, 4], [0, 0, -1])


def test_a_larger_picture_is_cut_to_the_middle_and_averaged(tmp_path: Path) -> None:
    codes = picture(tmp_path / "a.png", (36, 60))  # three times the view, and six columns too many on either side
    clip = source(tmp_path / "a.png").clip(0, np.random.default_rng(0))
    expected = srgb_to_linear(codes / 255)[:, 6:54].reshape(12, 3, 16, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(clip.rgb[0], expected, rtol=1e-5)
    middle = 2 / (1 / VIEW.near_m + 1 / VIEW.far_m)
    np.testing.assert_allclose(clip.depth_m, middle, rtol=1e-6)


def test_area_means_keep_the_light_at_any_size() -> None:
    values = np.random.default_rng(0).random((7, 5, 2))
    for shape in ((3, 4), (7, 5), (20, 11)):
        np.testing.assert_allclose(area_mean(values, shape).mean(axis=(0, 1)), values.mean(axis=(0, 1)), rtol=1e-6)
    # by hand: a pixel and a half each, from 0.5 on
    found = area_mean(np.array([[1.0, 2, 4, 8]]), (1, 2), [(0, 1), (0.5, 3.5)])
    np.testing.assert_allclose(found, [[(0.5 * 1 + 2) / 1.5, (4 + 0.5 * 8) / 1.5]], rtol=1e-6)


def test_parameters_come_from_yaml(tmp_path: Path) -> None:
    tetra(tmp_path)
    plugin = resolve("scene", "files", tmp_path)
    assert plugin.bind({"path": "tetra.obj"})["path"] == tmp_path / "tetra.obj"
    assert plugin.bind({"path": ["tetra.obj", "b.png"]})["path"] == [tmp_path / "tetra.obj", tmp_path / "b.png"]
    for wrong in ({"path": "a.obj", "length_of_unit_cm": 0}, {"path": "a.obj", "pose": "lying"}, {}):
        with pytest.raises(ParameterError):
            plugin.bind(wrong)


@pytest.mark.parametrize(
    ("name", "keywords", "message"),
    [
        ("gone.obj", {}, "^path: "),
        ("a.docx", {}, "^path: "),
        ("empty", {}, "^path: "),
        ("tetra.obj", {"pose": "as_is"}, "^pose: "),
        ("tetra.obj", {"plane_cm": 5.0}, "^plane_cm: "),
        ("a.png", {"length_of_unit_cm": 5.0}, "^length_of_unit_cm: "),
        ("a.png", {"plane_cm": 30.0}, "^plane_cm: "),
    ],
)
def test_mistakes_are_refused_before_the_work(
    tmp_path: Path, name: str, keywords: dict[str, Any], message: str
) -> None:
    tetra(tmp_path)
    picture(tmp_path / "a.png")
    (tmp_path / "a.docx").write_text("")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=message):
        source(tmp_path / name, **keywords)
    with pytest.raises(InputError, match=r"^path: "):
        source([])


@pytest.mark.parametrize(
    ("vertices", "keywords"),
    [
        ((0, 0, 5), {"pose": "as_is", "length_of_unit_cm": 1.0}),  # behind the camera
        ((0, 0, -30), {"pose": "as_is", "length_of_unit_cm": 1.0}),  # behind the wall
        ((0, 0, -15), {"pose": "as_is", "length_of_unit_cm": 2.0, "background": "black"}),  # beyond far
        ((40, 0, -10), {"pose": "as_is", "length_of_unit_cm": 1.0}),  # out of view
        ((40, 0, -10), {"pose": "as_is", "length_of_unit_cm": 1.0, "background": "black"}),
        ((0, 0, 0), {"length_of_unit_cm": 7.0}),  # too large
    ],
)
def test_models_that_do_not_fit_are_refused_with_the_cure(
    tmp_path: Path, vertices: tuple[float, ...], keywords: dict[str, Any]
) -> None:
    lines = [line.split() for line in TETRA.splitlines()]
    moved = [np.array(line[1:], float) + vertices for line in lines if line[0] == "v"]
    path = tmp_path / "model.obj"
    path.write_text(
        "\n".join([*(f"v {x} {y} {z}" for x, y, z in moved), *(" ".join(line) for line in lines if line[0] == "f")])
    )
    with pytest.raises(InputError, match=r"model\.obj: "):
        source(path, **keywords).clip(0, np.random.default_rng(0))


def test_broken_images_and_outputs_that_images_do_not_have_are_refused(tmp_path: Path) -> None:
    picture(tmp_path / "e.png")
    (tmp_path / "a.png").write_text("no image")
    for file, outputs, named in (
        ("e.png", ["motion"], "outputs"),
        ("e.png", ["hidden"], "outputs"),
        ("a.png", [], "png"),
    ):
        with pytest.raises(InputError, match=rf"\.{named}: "):
            source(tmp_path / file, *outputs).clip(0, np.random.default_rng(0))


def test_a_view_too_thin_for_models_is_refused_but_not_for_pictures(tmp_path: Path) -> None:
    view = View((12, 16), 160e-6, 1.9e-3, 0.05, 0.05)
    with pytest.raises(InputError, match=r"^scene: "):
        source(tetra(tmp_path), view=view)
    picture(tmp_path / "a.png")
    clip = source(tmp_path / "a.png", view=view).clip(0, np.random.default_rng(0))
    np.testing.assert_allclose(clip.depth_m, 0.05, rtol=1e-6)
