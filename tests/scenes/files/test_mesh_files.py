"""Meshes from files: the same geometry whatever the format, colours where they belong, faults named."""

from __future__ import annotations

import importlib
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenes.files import files
from scenes.files.mesh_files import baked, load_model, mesh_inputs
from simulator.colour import srgb_to_linear
from simulator.errors import InputError
from simulator.render import Renderer
from simulator.types import Clip, View

VIEW = View((24, 32), 80e-6, 1.9e-3, 0.036, 0.2)
UNIT_CM = 2.0
# A unit cube, its middle to the right, above and three units before the camera: files look along -z with y up.
MIDDLE = np.array([0.8, 0.7, -3.0])
CORNERS = MIDDLE + np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [triangle for a, b, c, d in QUADS for triangle in ((a, b, c), (a, c, d))]
PLY_HEADER = "ply\nformat ascii 1.0\nelement vertex {0}\nproperty double x\nproperty double y\nproperty double z\n{2}"
PLY_HEADER += "element face {1}\nproperty list uchar int vertex_indices\nend_header\n"


def ply(vertices: np.ndarray, faces: list[tuple[int, ...]], extra: str = "") -> str:
    """Return an ASCII PLY file; vertices may have more columns, which ``extra`` names."""
    head = PLY_HEADER.format(len(vertices), len(faces), extra)
    rows = [" ".join(f"{value:.9g}" for value in row) for row in vertices]
    return head + "\n".join([*rows, *(f"{len(face)} {' '.join(map(str, face))}" for face in faces)]) + "\n"


def stl(vertices: np.ndarray) -> bytes:
    facets = [struct.pack("<12f", 0, 0, 0, *vertices[list(t)].ravel()) + b"\0\0" for t in TRIANGLES]
    return b"\0" * 80 + struct.pack("<I", len(TRIANGLES)) + b"".join(facets)


def write_cube(folder: Path, suffix: str) -> Path:
    path = folder / f"cube{suffix}"
    if suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
        path.write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1} {d + 1}" for a, b, c, d in QUADS)]))
    elif suffix == ".ply":
        path.write_text(ply(CORNERS, TRIANGLES))
    elif suffix == ".stl":
        path.write_bytes(stl(CORNERS))
    else:
        path.write_bytes(glb(CORNERS - MIDDLE, np.array(TRIANGLES), {"translation": MIDDLE.tolist()}))
    return path


def glb(vertices: np.ndarray, faces: np.ndarray, node: dict[str, object]) -> bytes:
    """Return a GLB file of one mesh, whose node has a transform, as the glTF 2.0 specification lays it out."""
    points, numbers = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(points + numbers)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(numbers)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(points + numbers), 0x004E4942) + points + numbers
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def show(path: Path, *outputs: str, samples: int = 1, **keywords: object) -> Clip:
    """Render a file as it is, two centimetres a unit, before black."""
    given = {"pose": "as_is", "length_of_unit_cm": UNIT_CM, "background": "black", "up": "y"} | keywords
    source = files(VIEW, path=path, samples_per_pixel=samples, renderer=Renderer("scalar_rgb", outputs), **given)
    return source.clip(0, np.random.default_rng(0))


def directions() -> np.ndarray:
    rows, columns = VIEW.shape
    x, y = ((np.arange(size) - (size - 1) / 2) * VIEW.pixel_pitch_m / VIEW.distance_m for size in (columns, rows))
    return np.stack([*np.meshgrid(x, y), np.ones((rows, columns))], axis=-1)


def cube_depth(turn_degrees: float = 0.0) -> np.ndarray:
    """Depth of the cube by its three pairs of planes (Kay and Kajiya, 1986), metres; inf beside it."""
    cosine, sine = np.cos(np.radians(turn_degrees)), np.sin(np.radians(turn_degrees))
    ours = MIDDLE * (1, -1, -1) * UNIT_CM / 100
    x, y, z = np.moveaxis(directions(), -1, 0)
    rays = np.stack([cosine * x - sine * z, y, sine * x + cosine * z], axis=-1)  # into the cube's own axes
    with np.errstate(divide="ignore"):
        planes = np.stack([(ours + side * UNIT_CM / 200) / rays for side in (-1, 1)])
    enters, leaves = planes.min(axis=0).max(axis=-1), planes.max(axis=0).min(axis=-1)
    return np.where(enters < leaves, enters, np.inf)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb"])
def test_a_cube_is_where_it_should_be_whatever_the_format(tmp_path: Path, suffix: str) -> None:
    clip = show(write_cube(tmp_path, suffix))
    expected = cube_depth()
    assert 60 < np.isfinite(expected).sum() < 150
    np.testing.assert_array_equal(clip.valid[0], np.isfinite(expected))
    seen = clip.valid[0]
    np.testing.assert_allclose(clip.depth_m[0][seen], expected[seen], rtol=1e-5)
    row, column = np.argwhere(seen).mean(axis=0)
    assert column > 19, "to the right"
    assert row < 8, "above"


def test_a_turned_cube_shows_three_flat_sides(tmp_path: Path) -> None:
    turn = -15.0
    clip = show(write_cube(tmp_path, ".obj"), "normal", turn_degrees=turn)
    expected = cube_depth(turn)
    seen = clip.valid[0]
    np.testing.assert_array_equal(seen, np.isfinite(expected))
    np.testing.assert_allclose(clip.depth_m[0][seen], expected[seen], rtol=1e-5)
    normals = np.unique(clip.extras["normal"][0][seen].round(4), axis=0)
    assert len(normals) == 3, "facets stay flat: no normals came with the file, and edges are sharp"
    normals = normals[np.abs(normals[:, 1]) < 0.5]
    angles = np.degrees(np.arctan2(normals[:, 0], -normals[:, 2]))
    np.testing.assert_allclose(angles % 90, (-turn) % 90, atol=0.1)


def test_stl_has_z_up_and_a_mirrored_node_stays_right_side_out(tmp_path: Path) -> None:
    turned = CORNERS[:, (0, 2, 1)] * (1, -1, 1)  # the same cube with z up: what was -z is ahead, +y
    path = tmp_path / "cube.stl"
    path.write_bytes(stl(turned))
    np.testing.assert_allclose(show(path, up="auto").depth_m, show(write_cube(tmp_path, ".obj")).depth_m, rtol=1e-6)
    mirrored = tmp_path / "mirrored.glb"
    node: dict[str, object] = {"translation": [0.0, 0, -3], "scale": [-1.0, 1, 1]}
    mirrored.write_bytes(glb(np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0)]), np.array([(0, 1, 2)]), node))
    (part,) = load_model(mirrored).parts
    np.testing.assert_allclose(part.corners[:, 0].min(), -1)
    np.testing.assert_allclose(part.normals, np.tile([0, 0, -1.0], (3, 1)), atol=1e-12)  # to the viewer


def quad_obj(folder: Path, uv: list[tuple[float, float]], materials: str) -> Path:
    """Return a square that faces the camera, three units away; corners from the lower left, counter-clockwise."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    lines = ["mtllib quad.mtl", "usemtl paint", *(f"v {x} {y} -3" for x, y in corners)]
    lines += [*(f"vt {u} {v}" for u, v in uv), "f 1/1 2/2 3/3 4/4"]
    (folder / "quad.mtl").write_text("newmtl paint\n" + materials)
    (folder / "quad.obj").write_text("\n".join(lines))
    return folder / "quad.obj"


def four_colours(path: Path) -> np.ndarray:
    """Write a picture of four colours: red and green above, blue and grey below; return their linear light."""
    codes = np.array([[(200, 30, 10), (10, 180, 40)], [(20, 40, 220), (128, 128, 128)]], np.uint8)
    Image.fromarray(np.kron(codes, np.ones((8, 8, 1), np.uint8))).save(path)
    return srgb_to_linear(codes / 255.0)


CORNER_PIXELS = {(0, 0): (7, 11), (0, 1): (7, 20), (1, 0): (16, 11), (1, 1): (16, 20)}
UPRIGHT = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


@pytest.mark.parametrize("shift", [(0, 0), (2, 0), (-1, 3)])
def test_an_obj_texture_is_upright_not_mirrored_and_repeats(tmp_path: Path, shift: tuple[int, int]) -> None:
    light = four_colours(tmp_path / "four.png")
    uv = [(u + shift[0], v + shift[1]) for u, v in UPRIGHT]
    path = quad_obj(tmp_path, uv, "Kd 1 0.5 1\nmap_Kd four.png\n")
    assert mesh_inputs(path) == [path, tmp_path / "quad.mtl", tmp_path / "four.png"]
    albedo = show(path, "albedo").extras["albedo"][0]
    for corner, pixel in CORNER_PIXELS.items():
        np.testing.assert_allclose(albedo[pixel], light[corner] * (1, 0.5, 1), rtol=1e-4, atol=1e-6)


def test_a_gltf_texture_is_upright_and_multiplied_by_its_factor(tmp_path: Path) -> None:
    """The file is written by trimesh: its texture coordinates count from below, those of glTF from above."""
    trimesh: Any = importlib.import_module("trimesh")  # its stubs know no visuals
    light = four_colours(tmp_path / "four.png")
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(tmp_path / "four.png"), baseColorFactor=[255, 51, 255, 255], roughnessFactor=0.4
    )
    visual = trimesh.visual.TextureVisuals(uv=np.array(UPRIGHT), material=material)
    corners = np.array([(-1.0, -1, -3), (1, -1, -3), (1, 1, -3), (-1, 1, -3)])
    mesh = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], visual=visual, process=False)
    (tmp_path / "quad.glb").write_bytes(trimesh.Scene(mesh).export(file_type="glb"))
    (part,) = load_model(tmp_path / "quad.glb").parts
    assert part.roughness == 0.4
    albedo = show(tmp_path / "quad.glb", "albedo").extras["albedo"][0]
    for corner, pixel in CORNER_PIXELS.items():
        np.testing.assert_allclose(albedo[pixel], light[corner] * (1, 0.2, 1), rtol=1e-4, atol=1e-6)


def test_vertex_colours_blend_in_linear_light(tmp_path: Path) -> None:
    codes = np.array([(255, 0, 64), (0, 200, 0), (30, 0, 255)])
    corners = np.array([(-1.0, -1, -3), (1, -1, -3), (-1, 1, -3)])
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    path = tmp_path / "triangle.ply"
    path.write_text(ply(np.hstack([corners, codes]), [(0, 1, 2)], colours))
    clip = show(path, "albedo")
    x, y = np.moveaxis(directions()[clip.valid[0]][:, :2] * 3, -1, 0)
    weights = np.stack([-(x - y) / 2, (1 + x) / 2, (1 - y) / 2], axis=-1)
    assert len(x) > 40
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    # 8 bit fractions in Mitsuba's texture lookup would give 4e-3; it interpolates in float32
    np.testing.assert_allclose(
        clip.extras["albedo"][0][clip.valid[0]], weights @ srgb_to_linear(codes / 255.0), atol=1e-4
    )


def test_baked_texels_belong_to_one_triangle_only() -> None:
    colours = np.random.default_rng(0).random((7, 3, 3))
    uv, texture = baked(colours)
    texel = uv * texture.shape[0] - 0.5
    np.testing.assert_allclose(texel, np.round(texel), atol=1e-12)
    column, row = np.round(texel).astype(int).T
    np.testing.assert_allclose(texture[row, column], colours.reshape(-1, 3), rtol=1e-6)
    assert len(np.unique(np.stack([row // 2, column // 2]), axis=1).T) == 7


def test_two_materials_share_one_shape_and_gentle_bends_are_smooth(tmp_path: Path) -> None:
    trimesh: Any = importlib.import_module("trimesh")  # its stubs know no visuals
    path = quad_obj(tmp_path, UPRIGHT, "Kd 0.8 0.1 0.1\nnewmtl other\nKd 0.1 0.1 0.8\nNs 100\nKs 0 0 0\n")
    path.write_text(path.read_text().replace("f 1/1 2/2 3/3 4/4", "f 1 2 3\nusemtl other\nf 1 3 4"))
    (part,) = load_model(path).parts
    found = {tuple(round(value, 3) for value in texel) for texel in part.reflectance.reshape(-1, 3).tolist()}
    assert {(0.8, 0.1, 0.1), (0.1, 0.1, 0.8)} <= found
    assert part.roughness is None
    ball = tmp_path / "ball.stl"
    ball.write_bytes(trimesh.creation.icosphere(subdivisions=3).export(file_type="stl"))
    (part,) = load_model(ball).parts
    np.testing.assert_allclose(part.normals, part.corners, atol=0.02)  # facets are 8 degrees wide


BROKEN = {
    "points.ply": ply(CORNERS, []),
    "nan.obj": "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n",
    "line.obj": "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
    "missing.obj": "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "outside.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "words.stl": "hello",
    "words.glb": "hello hello hello hello",
    "words.gltf": "{",
    "list.gltf": "[]",
    "packed.gltf": '{"extensionsRequired": ["KHR_draco_mesh_compression"]}',
    "apart.gltf": '{"buffers": [{"uri": "a%20b.bin"}]}',
    "textured.ply": ply(CORNERS, TRIANGLES, "comment TextureFile skin.png\n"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(BROKEN[name])
    with pytest.raises(InputError, match=f"{name}: "):
        show(tmp_path / name)


@pytest.mark.parametrize("length", [1000, 84, 40])
def test_a_binary_stl_that_is_cut_short_is_refused(tmp_path: Path, length: int) -> None:
    trimesh: Any = importlib.import_module("trimesh")
    whole = trimesh.creation.icosphere(subdivisions=1).export(file_type="stl")
    path = tmp_path / "ball.stl"
    for head in (whole, b"solid" + whole[5:]):  # as some programs begin binary files too
        path.write_bytes(head[:length])
        with pytest.raises(InputError, match=r"ball\.stl: "):
            load_model(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("map_Kd gone.png", r"quad\.obj: "),
        ("map_Kd text.png", r"text\.png: "),
        ("map_Kd -s 2 2 2 text.png", r"quad\.mtl: "),
    ],
)
def test_a_missing_or_broken_texture_is_named(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match=message):
        show(quad_obj(tmp_path, UPRIGHT, line + "\n"))


def test_a_material_file_elsewhere_has_its_textures_beside_the_mesh(tmp_path: Path) -> None:
    """Where trimesh looks for them; it would leave out a missing one without a word."""
    (tmp_path / "paint").mkdir()
    light = four_colours(tmp_path / "paint" / "four.png")
    path = quad_obj(tmp_path, UPRIGHT, "Kd 1 1 1\nmap_Kd four.png\n")
    path.write_text(path.read_text().replace("quad.mtl", "paint/quad.mtl"))
    (tmp_path / "quad.mtl").rename(tmp_path / "paint" / "quad.mtl")
    with pytest.raises(InputError, match=r"quad\.obj: "):
        show(path)
    (tmp_path / "paint" / "four.png").rename(tmp_path / "four.png")
    np.testing.assert_allclose(show(path, "albedo").extras["albedo"][0][CORNER_PIXELS[0, 0]], light[0, 0], rtol=1e-4)
