"""What a scene refuses: each would render black, crash Mitsuba or hang it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.render import Box, Environment, EnvironmentMap, Material, Scene, Sphere, SphereLight, TriangleMesh

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


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Material(np.full((2, 2, 3), 7, np.float32)), r"0\.\.1, got a mean of 7"),
        (lambda: Material(np.full((2, 2, 3), np.nan, np.float32)), "got a mean of nan"),
        (lambda: Sphere(np.zeros(3), 0.0, GREY, np.eye(3)), r"Sphere needs .* positive radius"),
        (lambda: Sphere(np.array([0, 0, np.nan]), 1.0, GREY, np.eye(3)), "Sphere needs a finite centre"),
        (lambda: Box(np.zeros(3), np.array([1.0, 0, 1]), GREY, np.eye(3)), r"Box needs .* positive half edges"),
        (lambda: SphereLight(np.zeros(3), -1.0, np.ones(3)), r"SphereLight needs .* positive radius"),
        (lambda: SphereLight(np.zeros(3), 1.0, -np.ones(3)), r"SphereLight.radiance must be finite and not negative"),
        (lambda: Environment(np.array([1, np.inf, 1])), r"Environment.radiance must be finite"),
        (lambda: EnvironmentMap(np.ones((8, 8, 3), np.float32)), r"EnvironmentMap.radiance must be .h, 2 h, 3."),
        (lambda: Scene((), (Environment(np.ones(3)), Environment(np.ones(3)))), "got 2 surroundings"),
        (lambda: Scene((), (Environment(np.zeros(3)),)), "all 1 have radiance 0"),
    ],
)
def test_what_would_render_wrongly_without_a_word_is_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_a_scene_without_light_is_refused() -> None:
    with pytest.raises(InputError, match="at least one light"):
        Scene((TRIANGLE,), ())
    assert Scene((), (Environment(np.ones(3)),)).lights
