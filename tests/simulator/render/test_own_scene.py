"""A user's Mitsuba XML: seen from its own camera, in metres, and refused in words where it cannot be."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.render import Renderer
from simulator.render.own_scene import load_own_scene, own_scene_files
from simulator.types import Clip, View

VIEW = View((24, 32), 80e-6, 1.9e-3, 0.036, 0.2)
LIGHT = '<emitter type="constant"/>'
# From (3, 0, 0) along -x with z up: y runs to the right of the picture.
SENSOR = """
<sensor type="thinlens"><float name="fov" value="12"/><float name="aperture_radius" value="0.1"/>
  <float name="focus_distance" value="1"/>
  <transform name="to_world"><lookat origin="3, 0, 0" target="0, 0, 0" up="0, 0, 1"/></transform>
  <film type="hdrfilm"><integer name="width" value="5"/><integer name="height" value="4"/></film>
</sensor>
<integrator type="direct"/>"""
BALL = '<shape type="sphere" id="ball"><float name="radius" value="1.5"/></shape>'


def place(x: float, y: float, z: float, size: float) -> str:
    move = f'<translate x="{x}" y="{y}" z="{z}"/>'
    return f'<transform name="to_world"><scale value="{size}"/>{move}</transform>'


def write(folder: Path, *parts: str, name: str = "own.xml") -> Path:
    path = folder / name
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>', encoding="utf-8")
    return path


def render(
    path: Path,
    *,
    view: View = VIEW,
    metres_per_unit: float | None = None,
    outputs: tuple[str, ...] = (),
    samples: int = 4,
) -> Clip:
    renderer = Renderer("scalar_rgb", outputs)
    return renderer.own_still(
        path, view, metres_per_unit=metres_per_unit, samples_per_pixel=samples, seed=1, source={"kind": "xml"}
    )


def directions() -> np.ndarray:
    rows, columns = VIEW.shape
    x, y = ((np.arange(size) - (size - 1) / 2) * VIEW.pixel_pitch_m / VIEW.distance_m for size in (columns, rows))
    return np.stack([*np.meshgrid(x, y), np.ones((rows, columns))], axis=-1)


def ball_depth(distance: float, radius: float) -> np.ndarray:
    """Depth z of a ball on the axis along each pixel's ray, by the quadratic equation; NaN beside it."""
    d = directions()
    a, b = np.sum(d * d, axis=-1), d[..., 2] * distance
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (distance**2 - radius**2))) / a


def test_depth_is_z_in_metres_in_the_frame_of_its_own_camera(tmp_path: Path) -> None:
    # to the right of the axis and above it, and far nearer: no mirror, no turn
    cube = f'<shape type="cube" id="mark">{place(1.9, 0.4, 0.2, 0.1)}</shape>'
    clip = render(write(tmp_path, SENSOR, LIGHT, cube, BALL), metres_per_unit=0.05, outputs=("shape_id", "normal"))
    shape_id, depth = clip.extras["shape_id"][0], clip.depth_m[0]
    assert clip.source["shape_names"] == ["mark", "ball"]
    assert clip.source["metres_per_unit"] == 0.05
    expected = 0.05 * ball_depth(3.0, 1.5)
    np.testing.assert_array_equal(shape_id >= 0, clip.valid[0])
    seen = shape_id == 1
    assert seen.sum() > 150
    np.testing.assert_allclose(depth[seen], expected[seen], rtol=1e-5)  # float32 positions three units away
    assert not clip.valid[0][np.isnan(expected) & (shape_id != 0)].any()
    # the mark's front, x = 2, spans y = 0.3..0.5 and z = 0.1..0.3 at distance 1
    d = directions()
    front = (abs(d[..., 0] - 0.4) < 0.1) & (abs(d[..., 1] + 0.2) < 0.1)
    assert front.sum() > 10
    assert np.all(shape_id[front] == 0)
    np.testing.assert_allclose(depth[front], 0.05, rtol=1e-5)
    # outward normal of the ball, in camera axes
    point = d * (expected / 0.05)[..., np.newaxis]
    normal = (point - [0, 0, 3]) / 1.5
    np.testing.assert_allclose(clip.extras["normal"][0][seen], normal[seen], atol=1e-4)
    json.dumps(clip.source)


def test_without_a_scale_depths_lie_in_the_middle_of_the_range(tmp_path: Path) -> None:
    clip = render(write(tmp_path, SENSOR, LIGHT, BALL))
    seen = clip.depth_m[clip.valid]
    scale = clip.source["metres_per_unit"]
    np.testing.assert_allclose(seen.min() * seen.max(), VIEW.near_m * VIEW.far_m, rtol=1e-5)
    np.testing.assert_allclose(seen, scale * ball_depth(3.0, 1.5)[clip.valid[0]], rtol=1e-5)
    assert np.all(clip.depth_m[~clip.valid] == np.float32(VIEW.far_m))


def test_its_own_light_and_material_shine(tmp_path: Path) -> None:
    """A matt ball of reflectance rho under uniform light of radiance L has radiance rho L wherever it is seen."""
    grey = '<bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf>'
    light = '<emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>'
    ball = '<shape type="sphere"><float name="radius" value="1.5"/><ref id="grey"/></shape>'
    clip = render(write(tmp_path, SENSOR, light, grey, ball), outputs=("albedo",), samples=64)
    inside = ball_depth(3.0, 1.5) < 2.0
    assert inside.sum() > 100
    # 64 cosine-distributed samples of a constant are exact; light sampling of the environment adds noise
    np.testing.assert_allclose(clip.rgb[0][inside].mean(axis=0), 0.5 * np.array([0.2, 0.4, 0.6]), rtol=0.02)
    np.testing.assert_allclose(clip.extras["albedo"][0][inside], np.tile([0.2, 0.4, 0.6], (inside.sum(), 1)), rtol=1e-4)
    beside = np.isnan(ball_depth(3.0, 1.7))
    np.testing.assert_allclose(clip.rgb[0][beside], 0.5, rtol=1e-6)
    assert not clip.valid[0][beside].any()


def test_a_margin_is_what_a_wider_picture_shows_there(tmp_path: Path) -> None:
    """A quilt of lamps that face the camera, one for each coarse pixel: nothing in it is noise."""
    view, rng = replace(VIEW, margin=(8, 12)), np.random.default_rng(2)
    wide, coarseness = view.coarse_field
    assert (wide.shape, coarseness) == ((10, 14), 4)
    pixel, quilt = wide.pixel_pitch_m / wide.distance_m, [SENSOR]
    for tangents in np.stack(np.meshgrid(*wide.tangents, indexing="ij"), axis=-1).reshape(-1, 2):
        distance = rng.uniform(1, 3)
        (down, right), half = tangents * distance, pixel * distance / 2
        light = ", ".join(f"{value:.6f}" for value in rng.uniform(0.1, 1, 3))
        quilt.append(
            f'<shape type="rectangle"><transform name="to_world"><scale value="{half:.9f}"/><rotate y="1" angle="90"/>'
            f'<translate x="{3 - distance:.9f}" y="{right:.9f}" z="{-down:.9f}"/></transform>'
            f'<emitter type="area"><rgb name="radiance" value="{light}"/></emitter></shape>'
        )
    path = write(tmp_path, *quilt)
    clip, alone, field = (render(path, view=each, metres_per_unit=0.05) for each in (view, VIEW, view.field))
    np.testing.assert_array_equal(clip.rgb, alone.rgb)
    np.testing.assert_array_equal(clip.depth_m, alone.depth_m)
    around = clip.surroundings
    assert around is not None
    assert around.coarseness == 4
    light = field.rgb[0].reshape(10, 4, 14, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(around.rgb[0], light, rtol=1e-5)
    np.testing.assert_allclose(around.depth_m[0], field.depth_m[0, 2::4, 2::4], rtol=1e-5)


def test_without_a_camera_it_is_seen_from_the_origin_in_our_axes(tmp_path: Path) -> None:
    right_above = f'<shape type="sphere">{place(0.05, -0.03, 0.1, 0.02)}</shape>'
    clip = render(write(tmp_path, LIGHT, right_above), metres_per_unit=1.0)
    row, column = np.argwhere(clip.valid[0]).mean(axis=0)
    scale = VIEW.distance_m / VIEW.pixel_pitch_m
    assert column == pytest.approx(15.5 + 0.5 * scale, abs=0.5)
    assert row == pytest.approx(11.5 - 0.3 * scale, abs=0.5)


def instances(folder: Path) -> Path:
    """Two of a kind, one beside the other."""
    group = '<shape type="shapegroup" id="g"><shape type="sphere"><float name="radius" value="0.3"/></shape></shape>'
    one, two = (
        f'<shape type="instance" id="{name}">{place(0, y, 0, 1)}<ref id="g"/></shape>'
        for name, y in (("left", -0.7), ("right", 0.7))
    )
    return write(folder, SENSOR, LIGHT, group, one, two)


def test_instances_have_ids_of_their_own(tmp_path: Path) -> None:
    clip = render(instances(tmp_path), outputs=("shape_id",))
    shape_id = clip.extras["shape_id"][0]
    assert clip.source["shape_names"] == ["left", "right"]
    assert set(shape_id[:, :16].ravel()) == {-1, 0}
    assert set(shape_id[:, 16:].ravel()) == {-1, 1}


@pytest.mark.usefixtures("needs_llvm")
def test_instances_have_ids_of_their_own_with_llvm_too(
    tmp_path: Path, python: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Where all pixels are looked at together, by other code."""
    script = (
        "import sys, numpy as np\nfrom pathlib import Path\n"
        "from simulator.render import Renderer\nfrom simulator.types import View\n"
        "clip = Renderer('llvm_ad_rgb', ('shape_id',)).own_still(\n"
        "    Path(sys.argv[1]), View((24, 32), 80e-6, 1.9e-3, 0.036, 0.2), metres_per_unit=None,\n"
        "    samples_per_pixel=1, seed=1, source={})\n"
        "np.save(sys.argv[2], clip.extras['shape_id'][0])\n"
    )
    path = instances(tmp_path)
    done = python("-c", script, str(path), str(tmp_path / "ids.npy"))
    assert done.returncode == 0, done.stderr
    alone = render(path, outputs=("shape_id",)).extras["shape_id"][0]
    shape_id = np.load(tmp_path / "ids.npy")
    assert set(shape_id[:, :16].ravel()) == {-1, 0}
    assert set(shape_id[:, 16:].ravel()) == {-1, 1}
    assert np.sum(shape_id != alone) <= 2, "a ray that meets an outline may go either way"


def test_its_files_are_found_beside_it_wherever_one_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "parts").mkdir()
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "parts" / "red.png")
    write(
        tmp_path,
        '<bsdf type="diffuse" id="red"><texture type="bitmap" name="reflectance"><string name="filename" '
        'value="$folder/red.png"/></texture></bsdf>',
        name="materials.xml",
    )
    ball = '<shape type="sphere"><ref id="red"/></shape>'
    folder = '<default name="folder" value="parts"/>'
    path = write(tmp_path, folder, '<include filename="materials.xml"/>', SENSOR, LIGHT, ball)
    monkeypatch.chdir("/")
    assert own_scene_files(path) == [path, tmp_path / "materials.xml", tmp_path / "parts" / "red.png"]
    rgb = render(path).rgb[0, 12, 16]
    assert rgb[0] > 0.8
    assert rgb[1] < 0.01
    (tmp_path / "parts" / "red.png").unlink()
    with pytest.raises(InputError, match=r"own\.xml: "):
        own_scene_files(path)


def test_files_are_listed_where_the_home_cannot_be_written(
    tmp_path: Path, python: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Dr.Jit would abort the process that lists a data set's inputs, before any variant is chosen."""
    path = write(tmp_path, SENSOR, LIGHT, BALL)
    script = "import sys; from pathlib import Path; from simulator.render.own_scene import own_scene_files as files; "
    done = python("-c", script + "print(*files(Path(sys.argv[1])))", str(path), HOME="/dev/null/home")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(path)


AWAY = SENSOR.replace('target="0, 0, 0"', 'target="6, 0, 0"')


@pytest.mark.parametrize(
    "parts",
    [
        (SENSOR, '<emitter type="constant"><rgb name="radiance" value="0"/></emitter>', BALL),
        (SENSOR, BALL),
        (AWAY, LIGHT, BALL),
        (LIGHT, '<shape type="spheer"/>'),
        (LIGHT, BALL.replace("radius", "raduis")),
        (LIGHT, "<shape>"),
        (LIGHT, BALL, '<medium type="homogeneous" id="fog"/>'),
        (LIGHT, '<shape type="obj"><string name="filename" value="x.obj"/></shape>'),
        (SENSOR, LIGHT, BALL, f'<shape type="sphere">{place(-40, 27, 0, 4)}</shape>'),  # deeper than the range
    ],
)
def test_what_cannot_be_rendered_is_refused_with_its_file(tmp_path: Path, parts: tuple[str, ...]) -> None:
    path = write(tmp_path, *parts)
    with pytest.raises(InputError, match=r"own\.xml: "):
        render(path)


def test_depths_outside_the_range_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own\.xml: "):
        render(write(tmp_path, SENSOR, LIGHT, BALL), metres_per_unit=1.0)


@pytest.mark.parametrize("output", ["motion", "hidden"])
def test_outputs_that_are_not_known_are_refused(tmp_path: Path, output: str) -> None:
    with pytest.raises(InputError, match=r"^render\.outputs: "):
        render(write(tmp_path, SENSOR, LIGHT, BALL), outputs=(output,))


TRIANGLE = "v 1 1 1\nv -1 -1 1\nv -1 1 -1\nf 1 2 3\n"
INCLUDED = f'<scene version="3.0.0">{LIGHT}</scene>'


@pytest.mark.parametrize(
    ("part", "name", "content"),
    [
        ('<shape type="obj"><string name="filename" value="part.obj"/></shape>', "part.obj", TRIANGLE),
        ('<include filename="part.xml"/>', "part.xml", INCLUDED),
    ],
)
def test_a_file_in_the_current_directory_does_not_stand_in_for_one_beside_the_xml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str, name: str, content: str
) -> None:
    (tmp_path / "xml").mkdir()
    path = write(tmp_path / "xml", SENSOR, LIGHT, part)
    (tmp_path / name).write_text(content, encoding="utf-8")
    beside = tmp_path / "xml" / name
    monkeypatch.chdir(tmp_path)
    for given in (path, Path("xml") / path.name):
        with pytest.raises(InputError, match=rf"own\.xml: .*{beside}"):
            own_scene_files(given)
        with pytest.raises(InputError, match=rf"own\.xml: .*{beside}"):
            load_own_scene(given, VIEW, 3)
    beside.write_text(content, encoding="utf-8")
    assert own_scene_files(path) == [path, beside]
    (tmp_path / name).unlink()
    assert own_scene_files(path) == [path, beside], "whatever the current directory holds"


def test_a_folder_that_the_file_adds_is_looked_into(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = tmp_path / "xml" / "parts" / "part.obj"
    part.parent.mkdir(parents=True)
    part.write_text(TRIANGLE, encoding="utf-8")
    shape = '<shape type="obj"><string name="filename" value="part.obj"/></shape>'
    write(tmp_path / "xml", '<path value="parts"/>', LIGHT, shape)
    monkeypatch.chdir(tmp_path)
    assert own_scene_files(Path("xml/own.xml")) == [Path("xml/own.xml"), part]


def test_a_missing_file_and_one_that_is_no_scene_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.xml: "):
        load_own_scene(tmp_path / "nothing.xml", VIEW, 3)
    path = tmp_path / "bsdf.xml"
    path.write_text('<bsdf version="3.0.0" type="diffuse"/>', encoding="utf-8")
    with pytest.raises(InputError, match=r"bsdf\.xml: "):
        own_scene_files(path)
