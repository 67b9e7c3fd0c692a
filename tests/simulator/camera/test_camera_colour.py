"""Scene colours in the forward model: the mixture by hand, and what is clipped."""

import numpy as np
import pytest

from simulator.camera.colour import clipped_share, to_camera
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.types import Clip

MATRIX = np.array([[0.6, 0.3, 0.1], [0.1, 0.7, 0.2], [-0.5, 0.3, 1.2]])


def _image(shape=(5, 6)):
    return np.random.default_rng(5).random((*shape, 3), dtype=np.float32)


def _model(channels, matrix, size=5):
    """One depth whose PSF is a point: the image is the scene."""
    values = np.zeros((1, len(channels), 3, 3), np.float32)
    values[:, :, 1, 1] = 1
    stack = PsfStack(values, np.array([0.1]), 1e-5, channels, "test", {})
    return ForwardModel(stack, (size, size + 1), (size, size + 1), scene_to_camera=matrix)


def _clip(rgb):
    shape = rgb.shape[:2]
    return Clip(rgb[None], np.full((1, *shape), 0.1, np.float32), np.ones((1, *shape), bool), np.array([0.0, 1.0]))


def test_each_channel_is_its_rows_mixture():
    rgb = _image()
    expected = np.maximum(rgb.astype(np.float64) @ MATRIX.T, 0).transpose(2, 0, 1)
    got = to_camera(rgb, MATRIX)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=2e-7)  # three products in float32
    assert clipped_share(rgb, MATRIX) == np.mean(rgb.astype(np.float64) @ MATRIX.T < 0) > 0


def test_the_identity_changes_no_bit():
    rgb = _image()
    assert np.array_equal(to_camera(rgb, np.eye(3)), rgb.transpose(2, 0, 1))
    assert clipped_share(rgb, np.eye(3)) == 0


def test_the_forward_model_mixes_before_it_convolves():
    rgb = _image()
    np.testing.assert_allclose(
        _model(("R", "G", "B"), MATRIX).forward_clip(_clip(rgb)), to_camera(rgb, MATRIX), atol=1e-6
    )


@pytest.mark.parametrize(
    ("matrix", "words"), [(np.ones((1, 3)), "^scene_to_camera: "), (np.ones((3, 2)), "^scene_to_camera: ")]
)
def test_a_matrix_that_does_not_fit_is_refused(matrix, words):
    with pytest.raises(InputError, match=words):
        _model(("R", "G", "B"), matrix).forward_clip(_clip(_image()))
