"""A family of scenes of your own: `scene: {family: ./my_scenes.py:marbles, count: 30}`."""

from dataclasses import dataclass

import numpy as np

from simulator.render import Box, Environment, Material, Renderer, Scene, Sphere, SphereLight
from simulator.types import Clip, View


def marbles(view: View, *, count: int = 20, samples_per_pixel: int = 16, renderer: Renderer):
    """Return striped marbles before a wall; its keyword arguments are its YAML keys."""
    return Marbles(view, count, samples_per_pixel, renderer)


@dataclass(frozen=True)
class Marbles:
    """What Flatlight asks for its clips: the view to fill, the keys, and the renderer."""

    view: View
    count: int
    samples_per_pixel: int
    renderer: Renderer
    inputs: tuple = ()

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw wall, marbles and a lamp at the upper left from the sample's own generator, and render them."""
        near, far = 1.2 * self.view.near_m, 0.95 * self.view.far_m
        grey = Material(np.full((1, 1, 3), 0.2, np.float32))
        shapes = [Box(np.array([0, 0, far]), np.array([5, 5, 0.01]) * far, grey, np.eye(3))]
        for depth in 1 / rng.uniform(1.1 / far, 1 / near, self.count):
            across = rng.uniform(-1, 1, 2) * (self.view.tan_half_width, self.view.tan_half_height) * depth
            stripes = Material(rng.uniform(0.02, 0.8, (5, 1, 3)).astype(np.float32), roughness=0.3)
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            shapes.append(Sphere(np.array([*across, depth]), 0.12 * depth, stripes, turn))
        lamp = SphereLight(np.array([-1.5, -1.5, -1.0]) * far, 0.5 * far, np.full(3, 22.0))
        scene = Scene(tuple(shapes), (lamp, Environment(np.full(3, 0.15))))
        seed = int(rng.integers(2**32))
        return self.renderer.still(scene, self.view, samples_per_pixel=self.samples_per_pixel, seed=seed, source={})
