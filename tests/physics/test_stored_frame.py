"""The stored frame: shutter rows belong to the physical sensor, and are turned by 180 degrees with its picture.

The truth is drawn in the physical frame by rays alone: from a point through each opening of an asymmetric mask onto the rows
of the sensor, for as long as each is open. Only then it is turned. The Bayer part is in `test_stored_frame_bayer`.
"""

import numpy as np
import pytest

from simulator.camera.forward import ForwardModel
from simulator.camera.shutter import DualRollingShutter, RollingShutter, RowShutter
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.types import CameraGeometry, SpectralResponse

PITCH_M, MASK_PITCH_M, D_M, DEPTH_M = 40e-6, 10e-6, 2e-3, 0.05
SENSOR, SCENE = (60, 72), (20, 24)
OPENINGS = ((20, 24, 20), (44, 90, 28), (84, 40, 20))  # row, column, side in mask samples: no flip or turn maps them on
LINE_S, EXPOSURE_S = 1e-4, 1.3e-3
SHUTTERS = {
    "down": (RollingShutter(EXPOSURE_S, LINE_S, "down"), lambda row: row * LINE_S),
    "up": (RollingShutter(EXPOSURE_S, LINE_S, "up"), lambda row: (SENSOR[0] - 1 - row) * LINE_S),
    "dual": (DualRollingShutter(EXPOSURE_S, LINE_S), lambda row: min(row, SENSOR[0] - 1 - row) * LINE_S),
    "windows": (
        RowShutter(np.array([(r**2 * 1e-6, r**2 * 1e-6 + EXPOSURE_S) for r in range(SENSOR[0])])),
        lambda row: row**2 * 1e-6,
    ),
}
FRAMES = 20


@pytest.fixture(scope="module")
def stack():
    amplitude = np.zeros((120, 140))
    for row, column, side in OPENINGS:
        amplitude[row : row + side, column : column + side] = 1
    mask = Mask(np.zeros_like(amplitude), amplitude, MASK_PITCH_M)
    green = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
    return compute_psf_stack(mask, CameraGeometry(D_M, PITCH_M, green), PsfConfig((DEPTH_M,), "exact", 1, 1, None))


def _overlap(low, high, count):
    """The share of each of so many pixels about the axis that lies between two places on the sensor, metres."""
    edges = (np.arange(count + 1) - count / 2) * PITCH_M
    return np.diff(np.clip(edges, low, high)) / PITCH_M


def _shadow(x_m, y_m):
    """The light of a point at (x, y, DEPTH_M) on the physical sensor, x right and y down, drawn by rays."""
    image = np.zeros(SENSOR)
    for row, column, side in OPENINGS:
        ends = []
        for start, samples, source_m in ((row, 120, y_m), (column, 140, x_m)):
            low, high = ((edge - samples / 2) * MASK_PITCH_M for edge in (start, start + side))
            # From the point through the mask's plane, and on by D behind it.
            ends.append([place + (place - source_m) * D_M / DEPTH_M for place in (low, high)])
        image += np.outer(_overlap(*ends[0], SENSOR[0]), _overlap(*ends[1], SENSOR[1]))
    return image / (1 + D_M / DEPTH_M) ** 2


def _track(frame):
    """Row and column of the scene where the point stands: off the axis, and moving both down and to the left."""
    return 2 + frame * 12 // FRAMES, 22 - frame * 9 // FRAMES


def _truth(opening_of, edges_s):
    """What each physical row of the sensor gathers, physical orientation."""
    image = np.zeros(SENSOR)
    for frame in range(FRAMES):
        row, column = _track(frame)
        # The scene is upright: its pixel (row, column) looks down and right, with one pixel of the sensor per pixel.
        y_m, x_m = ((i - (n - 1) / 2) * PITCH_M * DEPTH_M / D_M for i, n in zip((row, column), SCENE, strict=True))
        shadow = _shadow(x_m, y_m)
        for r in range(SENSOR[0]):
            opening = opening_of(r)
            lit_s = min(edges_s[frame + 1], opening + EXPOSURE_S) - max(edges_s[frame], opening)
            image[r] += max(lit_s, 0.0) * shadow[r]
    return image


def _measured(stack, shutter, edges_s):
    volume = np.zeros((FRAMES, 1, 1, *SCENE), np.float32)
    for frame in range(FRAMES):
        volume[(frame, 0, 0, *_track(frame))] = 1
    return ForwardModel(stack, SENSOR, SCENE, shutter).forward(volume, edges_s)[0]


def _error(image, truth):
    return np.linalg.norm(image - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("kind", SHUTTERS)
def test_a_moving_point_under_a_shutter_is_the_physical_picture_turned(stack, kind):
    shutter, opening_of = SHUTTERS[kind]
    edges_s = np.linspace(0, shutter.duration_s(SENSOR[0]), FRAMES + 1)
    image, physical = _measured(stack, shutter, edges_s), _truth(opening_of, edges_s)
    # Rays know no diffraction: sqrt(532 nm x 2 mm) = 33 um blurs the edges of openings of 200 um and more, by under a pixel.
    # 0.055 was measured.
    assert _error(image, physical[::-1, ::-1]) < 0.07
    assert image.sum() == pytest.approx(physical.sum(), rel=0.005)
    others = [physical, physical[::-1], physical[:, ::-1]]
    assert min(_error(image, other) for other in others) > 1


def test_the_first_row_of_a_shutter_that_rolls_down_is_the_last_stored_one(stack):
    edges_s = np.array([0, LINE_S / 2, 1.0])
    volume = np.zeros((2, 1, 1, *SCENE), np.float32)
    volume[0] = 1  # light everywhere, but only until the second row opens
    for direction, first in (("down", SENSOR[0] - 1), ("up", 0)):
        image = ForwardModel(stack, SENSOR, SCENE, RollingShutter(EXPOSURE_S, LINE_S, direction)).forward(
            volume, edges_s
        )
        lit = np.flatnonzero(image[0].sum(axis=1))
        assert lit.tolist() == [first]
