"""Surfaces from files: small ones written here byte by byte, real ones against the facts known of them, and broken ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from scenes.endoscopy.vtk_polydata import read_surface, read_vtk_polydata
from simulator.errors import InputError

POINTS = [(0, 0, 0), (2, 0, 0), (2, 1.5, 0), (0, 1, 0), (1, 1, 3)]
HEADER = "# vtk DataFile Version {version}\na pyramid's base and side\n{kind}\nDATASET POLYDATA\nPOINTS 5 float\n"
# A quadrangle, cut around its first corner, and a triangle.
FACES = [(0, 1, 2), (0, 2, 3), (0, 4, 1)]


def ascii_text(cells: str = "POLYGONS 2 9\n4 0 1 2 3\n3 0 4 1\n", version: str = "3.0") -> str:
    points = "\n".join(" ".join(map(str, point)) for point in POINTS)
    return HEADER.format(version=version, kind="ASCII") + points + "\n" + cells


def binary(cells: bytes) -> bytes:
    head = HEADER.format(version="4.2", kind="BINARY").encode()
    return head + np.array(POINTS, ">f4").tobytes() + b"\n" + cells


def saved(folder: Path, content: str | bytes) -> Path:
    path = folder / "surface.vtk"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


OLD = b"POLYGONS 2 9\n" + np.array([4, 0, 1, 2, 3, 3, 0, 4, 1], ">i4").tobytes() + b"\n"
NEW = (
    b"METADATA\nINFORMATION 0\n\nPOLYGONS 3 7\nOFFSETS vtktypeint64\n"
    + np.array([0, 4, 7], ">i8").tobytes()
    + b"\nCONNECTIVITY vtktypeint64\n"
    + np.array([0, 1, 2, 3, 0, 4, 1], ">i8").tobytes()
    + b"\n"
)
ASCII_NEW = "POLYGONS 3 7\nOFFSETS vtktypeint64\n0 4 7\nCONNECTIVITY vtktypeint64\n0 1 2 3 0 4 1\n"
GOOD: dict[str, str | bytes] = {
    "ascii": ascii_text(),
    "ascii with lines and data": ascii_text(
        "LINES 1 3\n2 0 1\nPOLYGONS 2 9\n4 0 1 2 3\n3 0 4 1\n\nPOINT_DATA 5\nSCALARS a float\nLOOKUP_TABLE b\n1 2 3 4 5\n"
    ),
    "ascii 5.1": ascii_text(ASCII_NEW, "5.1"),
    "windows": ascii_text().replace("\n", "\r\n"),
    "binary": binary(OLD),
    "binary 5.1": binary(NEW),
}


@pytest.mark.parametrize("content", GOOD.values(), ids=GOOD.keys())
def test_every_flavour_gives_the_same_surface(tmp_path: Path, content: str | bytes) -> None:
    points, faces = read_surface(saved(tmp_path, content))
    np.testing.assert_array_equal(points, POINTS)
    assert sorted(map(tuple, faces.tolist())) == FACES


def test_triangles_alone_are_read_in_order(tmp_path: Path) -> None:
    _, faces = read_vtk_polydata(saved(tmp_path, ascii_text("POLYGONS 2 8\n3 0 1 2\n3 0 4 1\n")))
    np.testing.assert_array_equal(faces, [(0, 1, 2), (0, 4, 1)])


BROKEN: dict[str, str | bytes] = {
    "no vtk": "solid cube\n",
    "volume": ascii_text().replace("POLYDATA", "STRUCTURED_POINTS"),
    "no faces": ascii_text(""),
    "only lines": ascii_text("LINES 1 3\n2 0 1\n"),
    "strips": ascii_text("TRIANGLE_STRIPS 1 5\n4 0 1 2 3\n"),
    "nan": ascii_text().replace("1.5", "nan"),
    "truncated ascii": ascii_text()[:-6],
    "truncated points": ascii_text()[:100],
    "truncated binary": binary(OLD)[:-9],
    "text": ascii_text().replace("1.5", "one"),
    "wrong point": ascii_text("POLYGONS 1 4\n3 0 1 7\n"),
    "counts": ascii_text("POLYGONS 2 9\n4 0 1 2 3\n2 0 1 4\n"),
    "type": ascii_text().replace("float", "quad"),
    "mode": ascii_text().replace("ASCII", "HEX"),
    "count": ascii_text().replace("POINTS 5", "POINTS five"),
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN.keys())
def test_broken_files_are_refused_by_name(tmp_path: Path, content: str | bytes) -> None:
    path = saved(tmp_path, content)
    with pytest.raises(InputError, match=f"^surface: {path}"):
        read_surface(path)


def test_missing_files_and_files_of_no_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^surface: "):
        read_surface(tmp_path / "missing.vtk")
    (tmp_path / "odd.xyzzy").write_text("nothing")
    with pytest.raises(InputError, match=r"^surface: "):
        read_surface(tmp_path / "odd.xyzzy")


def test_other_meshes_come_through_trimesh(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 2, 3))
    box.export(tmp_path / "box.ply")
    points, faces = read_surface(tmp_path / "box.ply")
    assert trimesh.Trimesh(points, faces).volume == pytest.approx(6)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "points", "faces", "border"),
    [("A-DSJ", 9958, 19838, 88), ("DSJ-SF-", 9421, 18644, 198), ("SF+-HF-", 15592, 30956, 240)],
)
def test_real_colons_have_the_sizes_and_borders_known_of_them(
    shared_data: Path, name: str, points: int, faces: int, border: int
) -> None:
    path = shared_data / f"colon_mesh/EdinGCA_3D_00020/SegmentedSurfaces/large-intestine-{name}.vtk"
    found, triangles = read_vtk_polydata(path)
    assert (len(found), len(triangles)) == (points, faces)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (int((uses == 1).sum()), int(uses.max())) == (border, 2)
    # The bounding box of the voxels in the data set's own description; the surface runs around them, smoothed.
    assert np.all(found.min(axis=0) >= np.array((56, 63, 35)) - 1.5)
    assert np.all(found.max(axis=0) <= np.array((466, 394, 669)) + 1.5)
