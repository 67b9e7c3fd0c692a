"""From a configuration to the objects of the light path: mask, camera, PSF stack, view, scenes, sensor, forward model."""

from simulator.assemble.camera import build_sensor
from simulator.assemble.captured import build_captured_stack, check_calibration
from simulator.assemble.checks import check_psf_stack, wants_full_check
from simulator.assemble.forward import build_forward_model
from simulator.assemble.inputs import input_files
from simulator.assemble.light import build_camera_colour, build_response
from simulator.assemble.masks import build_mask, load_mask
from simulator.assemble.psfs import build_geometry, build_psf_config, build_psf_stack
from simulator.assemble.scenes import build_source, build_view, scene_plugin
from simulator.assemble.shutter import build_shutter

__all__ = [
    "build_camera_colour",
    "build_captured_stack",
    "build_forward_model",
    "build_geometry",
    "build_mask",
    "build_psf_config",
    "build_psf_stack",
    "build_response",
    "build_sensor",
    "build_shutter",
    "build_source",
    "build_view",
    "check_calibration",
    "check_psf_stack",
    "input_files",
    "load_mask",
    "scene_plugin",
    "wants_full_check",
]
