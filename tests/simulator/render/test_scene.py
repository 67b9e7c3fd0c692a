"""What a scene refuses: each would render black, crash Mitsuba or hang it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.render import Environment, Material, Scene, TriangleMesh

GREY = Material(np.full((2, 2, 3), 0.5, dtype=np.float32))
TRIANGLE = TriangleMesh(
    np.array([(0.0, 0, 0.1), (0.01, 0, 0.1), (0, 0.01, 0.1)]),
    np.tile([0.0, 0, -1], (3, 1)),
    np.zeros((3, 2)),
    np.array([(0, 2, 1)]),
    GREY,
)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"faces": np.zeros((0, 3), int)}, "at least one face"),
        ({"faces": np.array([(0, 1)])}, r"got \(1, 2\)"),
        ({"faces": np.array([(0, 1, 3)])}, "0 to 2; got 0 to 3"),
        ({"faces": np.array([(0, 1, -1)])}, "got -1 to 1"),
        ({"vertices_m": np.array([(0.0, 0, np.nan), (0.01, 0, 0.1), (0, 0.01, 0.1)])}, "vertices_m .* NaN"),
        ({"normals": np.zeros((2, 3))}, r"normals must be \(3, 3\)"),
        ({"uv": np.full((3, 2), np.inf)}, "uv must be"),
    ],
)
def test_a_broken_mesh_is_refused(changes: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(TRIANGLE, **changes)


def test_a_material_is_a_colour_picture_and_a_share() -> None:
    with pytest.raises(InputError, match=r"\(h, w, 3\) linear RGB, got \(4, 4\)"):
        Material(np.ones((4, 4), np.float32))
    with pytest.raises(InputError, match=r"0\.\.1, got 1\.5"):
        replace(GREY, roughness=1.5)


def test_a_scene_without_light_is_refused() -> None:
    with pytest.raises(InputError, match="at least one light"):
        Scene((TRIANGLE,), ())
    assert Scene((), (Environment(np.ones(3)),)).lights
