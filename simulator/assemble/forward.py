"""The forward model of a configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.assemble.light import build_camera_colour
from simulator.assemble.scenes import build_view
from simulator.assemble.shutter import build_shutter
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.camera.planes import mask_irradiance
from simulator.camera.shutter import Shutter
from simulator.optics.stack import PsfStack

if TYPE_CHECKING:
    from simulator.config import Config


def build_forward_model(config: Config, stack: PsfStack, shutter: Shutter | None = None) -> ForwardModel:
    """Return the forward model of a configuration and its PSF stack.

    Args:
        config: the configuration.
        stack: its PSFs.
        shutter: its shutter, where it is built already; None builds it.
    """
    chosen = config.forward
    return ForwardModel(
        stack,
        config.camera.sensor.shape,
        config.scene.size,
        build_shutter(config) if shutter is None else shutter,
        chosen.boundary,
        time=chosen.time,
        irradiance=mask_irradiance(build_view(config), chosen.vignetting),
        scene_to_camera=build_camera_colour(config, stack.channels).matrix,
        depth_rule=DepthRule(chosen.depth_assignment, chosen.max_clamped),
    )
