"""The stored frame (PHYSICS section 1): asymmetric mask, off-centre moving point, rolling shutter and Bayer sensor together.

The truth is worked out in the physical sensor's own axes, pixel by pixel, and turned by 180 degrees at the very end.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.forward import ForwardModel
from simulator.camera.noise import NoNoise
from simulator.camera.sensor import Sensor
from simulator.camera.shutter import DualRollingShutter, RollingShutter
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.types import CameraGeometry, Clip, SpectralResponse

PITCH_M, DISTANCE_M, DEPTH_M = 20e-6, 1.9e-3, 0.03
LINES_M = (610e-9, 532e-9, 460e-9)
SCENE = (8, 10)


@pytest.fixture(scope="module")
def mask():
    """Three holes and a bar: no flip or turn leaves it as it is."""
    amplitude = np.zeros((80, 80))
    for row, column in ((6, 10), (20, 60), (66, 30)):
        amplitude[row : row + 9, column : column + 9] = 1
    amplitude[40:45, 44:74] = 1
    return Mask(np.zeros_like(amplitude), amplitude, 4e-6)


@pytest.fixture(scope="module")
def stack(mask):
    wavelengths_m = np.arange(450e-9, 621e-9, 1e-9)
    weights = np.array([np.isclose(wavelengths_m, line, atol=1e-10) for line in LINES_M], np.float64)
    response = SpectralResponse(wavelengths_m, weights, ("R", "G", "B"), "three lines")
    config = PsfConfig((DEPTH_M,), model="exact", wavelengths_per_channel=1)
    return compute_psf_stack(mask, CameraGeometry(DISTANCE_M, PITCH_M, response), config)


def _fresnel(mask, wavelength_m, centre):
    """Irradiance in the physical frame, x right and y down, pixel (row, column) = (y, x) / pitch + centre.

    The Fresnel integral is separable; 8 x 8 points in each pixel and 8 in each sample of the mask are averaged.
    """
    k, fine = 2 * np.pi / wavelength_m, mask.pitch_m / 8
    opening = np.kron(mask.amplitude, np.ones((8, 8)))
    at = (np.arange(len(opening)) - (len(opening) - 1) / 2) * fine
    points = (np.arange(2 * centre + 1)[:, None] - centre + (np.arange(8) + 0.5) / 8 - 0.5).ravel() * PITCH_M
    phase = (points[:, None] - at) ** 2 / (2 * DISTANCE_M) + at**2 / (2 * DEPTH_M)
    wave = np.exp(1j * k * phase) * fine
    field = wave @ opening @ wave.T / (wavelength_m * DISTANCE_M)
    return (np.abs(field) ** 2).reshape(2 * centre + 1, 8, 2 * centre + 1, 8).mean((1, 3))


def test_the_stored_psf_is_the_physical_one_turned(mask, stack):
    values = stack.values[0]
    centre = 14
    for channel, line_m in enumerate(LINES_M):
        physical = _fresnel(mask, line_m, centre)
        middle = values.shape[-1] // 2
        stored = values[channel, middle - centre : middle + centre + 1, middle - centre : middle + centre + 1]
        difference = np.linalg.norm(stored[::-1, ::-1] - physical) / np.linalg.norm(physical)
        assert difference < 5e-3, channel  # paraxial against exact: 3e-3
        for wrong in (stored, stored[::-1], stored[:, ::-1], stored.T[::-1, ::-1]):
            assert np.linalg.norm(wrong - physical) / np.linalg.norm(physical) > 1


@pytest.mark.parametrize("cfa", ["RGGB", "GRBG"])
@pytest.mark.parametrize("sensor_shape", [(38, 44), (24, 20)], ids=["large", "cropping"])
@pytest.mark.parametrize(
    "shutter",
    [RollingShutter(2e-3, 1e-4), RollingShutter(2e-3, 1e-4, "up"), DualRollingShutter(1e-3, 2e-4, "centre_out")],
    ids=["down", "up", "dual"],
)
def test_one_capture_with_everything_that_turns(stack, shutter, sensor_shape, cfa):
    rows, columns = sensor_shape
    edges = np.linspace(0, shutter.duration_s(rows), 5)
    light = np.random.default_rng(0).uniform(0.5, 1, (4, 3)).astype(np.float32)
    places = [(1, 7), (2, 8), (2, 1), (6, 3)]  # of the point in the scene's image, upright, in each frame
    rgb = np.zeros((4, *SCENE, 3), np.float32)
    for frame, place in enumerate(places):
        rgb[frame][place] = light[frame]
    clip = Clip(rgb, np.full(rgb.shape[:3], DEPTH_M, np.float32), np.ones(rgb.shape[:3], bool), edges)
    sensor = Sensor(
        "s", PITCH_M, sensor_shape, 1, sensor_shape, 1e4, 0, 0, 0, 0, 0.0, 12, noise=NoNoise(), readout="bayer", cfa=cfa
    )
    exposure = ForwardModel(stack, sensor_shape, SCENE, shutter).forward_clip(clip)
    stored = sensor.expose(exposure, np.random.default_rng(0))
    assert stored.shape == (1, rows, columns)

    # Physical axes: a point at (X, Y, z) moves the light by (-X, -Y) d / z; its pixel j looks along X / z = x_j / d.
    size = stack.values.shape[-1]
    physical = np.zeros(sensor_shape)
    for row in range(rows):
        opens = {
            "down": row * 1e-4,
            "up": (rows - 1 - row) * 1e-4,
            "dual": (rows // 2 - 1 - min(row, rows - 1 - row)) * 2e-4,
        }[_name(shutter)]
        for column in range(columns):
            colour = "RGB".index(cfa[2 * (row % 2) + column % 2])
            for frame, (i, j) in enumerate(places):
                x, y = (j - (SCENE[1] - 1) / 2) * PITCH_M, (i - (SCENE[0] - 1) / 2) * PITCH_M
                here_x, here_y = (column - (columns - 1) / 2) * PITCH_M, (row - (rows - 1) / 2) * PITCH_M
                at = (round((here_y + y) / PITCH_M), round((here_x + x) / PITCH_M))  # from the PSF's origin
                # A grid of an even number has its origin on sample size // 2 of the stored, turned frame.
                place = (size // 2 - at[0], size // 2 - at[1])
                if not all(0 <= p < size for p in place):
                    continue
                open_s = min(edges[frame + 1], opens + shutter.exposure_s) - max(edges[frame], opens)
                physical[row, column] += max(open_s, 0) * light[frame, colour] * stack.values[0, colour][place]
    # float32 FFTs.
    np.testing.assert_allclose(stored[0], physical[::-1, ::-1], atol=2e-6 * physical.max())
    # Nothing that failed to turn would have passed: the picture, the colours, or the rows (those of a dual shutter mirror).
    unturned = replace(sensor, cfa=sensor.stored_cfa or "").expose(exposure, np.random.default_rng(0))
    wrong = [physical, unturned[0]]
    if isinstance(shutter, RollingShutter):
        other = replace(shutter, direction="up" if shutter.direction == "down" else "down")
        reversed_rows = ForwardModel(stack, sensor_shape, SCENE, other).forward_clip(clip)
        wrong.append(sensor.expose(reversed_rows, np.random.default_rng(0))[0])
    for picture in wrong:
        assert np.linalg.norm(picture - stored[0]) > 0.1 * np.linalg.norm(stored)


def _name(shutter):
    return "dual" if isinstance(shutter, DualRollingShutter) else shutter.direction
