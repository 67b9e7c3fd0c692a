"""Captures without a data set."""

import numpy as np
import pytest

from learning.reconstruction.plain_capture import plain_capture, typical_white
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError
from simulator.optics.stack import PsfStack


def random_stack(channels: tuple[str, ...], planes: int = 2) -> PsfStack:
    values = np.random.default_rng(0).random((planes, len(channels), 5, 5), np.float32)
    return PsfStack(values, np.linspace(0.1, 0.2, planes), 1e-5, channels, "random")


@pytest.mark.parametrize("channels", [("R", "G", "B"), ("Y",)])
def test_srgb_of_a_plain_capture_is_what_the_camera_saw(channels: tuple[str, ...]) -> None:
    capture = plain_capture(random_stack(channels), (12, 16), (8, 8))
    seen = np.random.default_rng(1).random((len(channels), 8, 8))
    # One channel becomes red, green and blue alike.
    np.testing.assert_allclose(capture.to_srgb(seen), np.broadcast_to(seen, (3, 8, 8)), rtol=1e-12)


def test_scene_is_the_sensor_unless_said() -> None:
    capture = plain_capture(random_stack(("Y",)), (12, 16), background=3.0)
    assert capture.scene_shape == (12, 16)
    assert capture.offset.tolist() == [3.0]


def test_white_is_twice_the_mean_of_a_uniform_scene() -> None:
    stack = random_stack(("R", "G", "B"), planes=1)
    capture = plain_capture(stack, (12, 12), (6, 6), background=0.5)
    volume = np.full((1, 1, 3, 6, 6), 0.7)
    measurement = ForwardModel(stack, (12, 12), (6, 6)).forward(volume) + 0.5  # the sensor holds all of the light
    assert typical_white(capture, measurement) == pytest.approx(1.4, rel=1e-6)


def test_darkness_has_no_white() -> None:
    capture = plain_capture(random_stack(("Y",)), (8, 8), background=2.0)
    with pytest.raises(InputError, match="expected light; check the background"):
        typical_white(capture, np.full((1, 8, 8), 2.0))


def test_two_channels_are_refused() -> None:
    with pytest.raises(InputError, match=r"stack: got 2 channels \(a, b\), expected 1 \(grey\) or 3"):
        plain_capture(random_stack(("a", "b")), (8, 8))
