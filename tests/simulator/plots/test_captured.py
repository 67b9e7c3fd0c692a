"""What a calibration changed, in numbers: shifts found again in noise, differences as defined, other stacks refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.plots.captured import captured_differences, describe_captured, plot_captured, registration_shift


def pattern(shift=(0.0, 0.0)) -> np.ndarray:
    """Smooth spots in a dark frame, moved by (x, y) pixels: drawn there, not resampled."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:91, :101]
    places = rng.uniform((30, 30), (60, 70), (12, 2))
    return sum(np.exp(-((y - r - shift[1]) ** 2 + (x - c - shift[0]) ** 2) / 8) for r, c in places)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.31, -0.07), (-4.6, 3.2)])
def test_shifts_are_found_again_to_parts_of_a_pixel(shift) -> None:
    np.testing.assert_allclose(registration_shift(pattern(), pattern(shift)), shift, atol=1e-6)


def test_noise_far_from_the_psf_does_not_matter() -> None:
    noisy = np.maximum(pattern((1.3, -0.6)) + 0.02 * np.random.default_rng(0).standard_normal((91, 101)), 0)
    np.testing.assert_allclose(registration_shift(pattern(), noisy), (1.3, -0.6), atol=0.02)


@pytest.fixture
def stacks() -> tuple[PsfStack, PsfStack]:
    values = np.stack([np.stack([gaussian_filter(pattern(), s)] * 3) for s in (0.5, 1.0)]).astype(np.float32)
    nominal = PsfStack(values, np.array([0.05, np.inf]), 1e-5, ("R", "G", "B"), "true")
    record = {
        "nominal_fingerprint": "true",
        "response": "an LED",
        "true_depths_m": [0.0503, "inf"],
        "recordings": [{"snr_db": 40.0}, {"snr_db": 37.0}],
    }
    captured = replace(nominal, values=values * np.float32(1.1), fingerprint="found", provenance=record)
    return nominal, captured


def test_differences_of_a_stack_that_is_a_tenth_brighter(stacks) -> None:
    near, far = captured_differences(*stacks)
    assert (near.depth_m, far.depth_m) == (0.05, np.inf)
    for row in (near, far):
        assert row.relative_l2 == pytest.approx(0.1, rel=1e-5)
        assert row.energy_ratio == pytest.approx(1.1, rel=1e-6)
        assert row.shift_px == pytest.approx((0, 0), abs=1e-7)  # float32
    table = describe_captured(*stacks)
    for words in ("an LED", "5 cm", "+0.30 mm", "10 %", "110 %", "40 dB", "∞", "37 dB"):
        assert words in table


def test_the_image_is_drawn(stacks, tmp_path) -> None:
    from PIL import Image

    image = np.asarray(Image.open(plot_captured(*stacks, tmp_path / "captured.png")).convert("RGB")).astype(int)
    third = image[2 * len(image) // 3 : -len(image) // 6]
    # Captured is brighter: the differences are red, nowhere blue.
    assert np.any(third[..., 0] - third[..., 2] > 80)
    assert not np.any(third[..., 2] - third[..., 0] > 20)


def test_another_stack_is_refused(stacks) -> None:
    nominal, captured = stacks
    with pytest.raises(InputError, match=r"^captured: "):
        captured_differences(replace(nominal, fingerprint="other"), captured)
