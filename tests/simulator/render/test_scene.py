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
    ("name", "values"),
    [
        ("faces", np.zeros((0, 3), int)),
        ("faces", np.array([(0, 1)])),
        ("faces", np.array([(0, 1, 3)])),
        ("faces", np.array([(0, 1, -1)])),
        ("vertices_m", np.array([(0.0, 0, np.nan), (0.01, 0, 0.1), (0, 0.01, 0.1)])),
        ("normals", np.zeros((2, 3))),
        ("uv", np.full((3, 2), np.inf)),
    ],
)
def test_a_broken_mesh_is_refused(name: str, values: np.ndarray) -> None:
    with pytest.raises(InputError, match=rf"^TriangleMesh\.{name}: "):
        replace(TRIANGLE, **{name: values})


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Material(np.ones((4, 4), np.float32)), r"^Material\.reflectance: "),
        (lambda: replace(GREY, roughness=1.5), r"^Material\.roughness: "),
        (lambda: Material(np.full((2, 2, 3), 7, np.float32)), r"^Material\.reflectance: "),
        (lambda: Material(np.full((2, 2, 3), np.nan, np.float32)), r"^Material\.reflectance: "),
        (lambda: Sphere(np.zeros(3), 0.0, GREY, np.eye(3)), "^Sphere: "),
        (lambda: Sphere(np.array([0, 0, np.nan]), 1.0, GREY, np.eye(3)), "^Sphere: "),
        (lambda: Box(np.zeros(3), np.array([1.0, 0, 1]), GREY, np.eye(3)), "^Box: "),
        (lambda: SphereLight(np.zeros(3), -1.0, np.ones(3)), "^SphereLight: "),
        (lambda: SphereLight(np.zeros(3), 1.0, -np.ones(3)), r"^SphereLight\.radiance: "),
        (lambda: Environment(np.array([1, np.inf, 1])), r"^Environment\.radiance: "),
        (lambda: EnvironmentMap(np.ones((8, 8, 3), np.float32)), r"^EnvironmentMap\.radiance: "),
        (lambda: Scene((), (Environment(np.ones(3)), Environment(np.ones(3)))), r"^Scene\.lights: "),
        (lambda: Scene((), (Environment(np.zeros(3)),)), r"^Scene\.lights: "),
        (lambda: Scene((TRIANGLE,), ()), r"^Scene\.lights: "),
    ],
)
def test_what_would_render_wrongly_without_a_word_is_refused(make: Callable[[], object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        make()
