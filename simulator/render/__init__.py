"""Rendering with Mitsuba 3: the choice of backend, scenes in metres, and stills with colour and depth."""

from simulator.render.backend import Backend, activate, choose_backend
from simulator.render.scene import Box, Environment, Material, Scene, Sphere, SphereLight, TriangleMesh
from simulator.render.still import render_still

__all__ = [
    "Backend",
    "Box",
    "Environment",
    "Material",
    "Scene",
    "Sphere",
    "SphereLight",
    "TriangleMesh",
    "activate",
    "choose_backend",
    "render_still",
]
