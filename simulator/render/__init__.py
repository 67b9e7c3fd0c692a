"""Rendering with Mitsuba 3: the choice of backend, scenes in metres, stills and clips with colour, depth and more."""

from simulator.render.backend import Backend, activate, choose_backend
from simulator.render.renderer import Renderer
from simulator.render.scene import (
    Box,
    Environment,
    EnvironmentMap,
    Light,
    Material,
    Scene,
    Shape,
    Sphere,
    SphereLight,
    TriangleMesh,
)

__all__ = [
    "Backend",
    "Box",
    "Environment",
    "EnvironmentMap",
    "Light",
    "Material",
    "Renderer",
    "Scene",
    "Shape",
    "Sphere",
    "SphereLight",
    "TriangleMesh",
    "activate",
    "choose_backend",
]
