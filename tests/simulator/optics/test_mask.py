"""The mask's transmission against hand formulas; staircase and smooth refinement; what is refused."""

import numpy as np
import pytest
import torch

from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA, PHLATCAM_RESIST

GREEN = 532e-9


def _mask(height, amplitude=None, pitch_m=2e-6, profile="staircase", material=FUSED_SILICA):
    return Mask(height, np.ones_like(height) if amplitude is None else amplitude, pitch_m, material, profile)


@pytest.mark.parametrize(
    ("dtype", "complex_type", "tolerance"), [(np.float32, np.complex64, 6e-6), (np.float64, np.complex128, 1e-12)]
)
def test_transmission_is_the_thin_elements(dtype, complex_type, tolerance):
    """A exp(2 pi i (n - 1) h / lambda): heights to 5 um are 5 turns, whose rounding is 5 x 6e-8 x 2 pi in float32."""
    rng = np.random.default_rng(0)
    height, amplitude = rng.uniform(0, 5e-6, (9, 14)).astype(dtype), rng.uniform(0, 1, (9, 14)).astype(dtype)
    field = _mask(height, amplitude).transmission(GREEN)
    phase = 2 * np.pi * (1.46071 - 1) * height.astype(np.float64) / GREEN
    assert field.dtype == complex_type
    # The published index has 5 digits: 5e-6 x 5 um x 2 pi / 532 nm of phase.
    np.testing.assert_allclose(field, amplitude * np.exp(1j * phase), atol=4e-4)
    exact = 2 * np.pi * (FUSED_SILICA.index(GREEN) - 1) * height.astype(np.float64) / GREEN
    np.testing.assert_allclose(field, amplitude * np.exp(1j * exact), atol=tolerance)


@pytest.mark.parametrize("degrees", [0, 15, 40, 70])
def test_oblique_light_takes_the_path_that_snell_says(degrees):
    """Between two parallel fronts: h n / cos(inside) along the bent ray, less the air it spares and the step aside."""
    index, sine = 1.5103, np.sin(np.radians(degrees))  # the resist's at 532 nm
    outside, inside = np.radians(degrees), np.arcsin(sine / index)
    height = np.linspace(0, 2e-6, 12).reshape(3, 4)
    aside = height * np.tan(inside) * sine
    path = height * index / np.cos(inside) - aside - height * np.cos(outside)
    field = _mask(height, material=PHLATCAM_RESIST).transmission(GREEN, sine=sine)
    np.testing.assert_allclose(field, np.exp(2j * np.pi * path / GREEN), atol=1e-9)


def test_float32_keeps_its_digits_at_any_height():
    """Heights that are exact in float32, 165 turns high: one rounded product, 6e-8 x 165 turns x 2 pi = 6e-5."""
    height = np.arange(400, dtype=np.float32).reshape(20, 20) * np.float32(2.0**-21)
    single, double = (_mask(height.astype(dtype)).transmission(GREEN) for dtype in (np.float32, np.float64))
    assert np.abs(single - double).max() < 1e-4


def test_torch_and_numpy_agree_and_gradients_pass():
    height = np.random.default_rng(0).uniform(0, 1e-6, (6, 5))
    tensor = torch.tensor(height, requires_grad=True)
    mask = Mask(tensor, torch.ones(6, 5, dtype=torch.float64), 2e-6, FUSED_SILICA, "smooth")
    field = mask.transmission(GREEN, 3)
    expected = _mask(height, profile="smooth").transmission(GREEN, 3)
    np.testing.assert_allclose(field.detach().numpy(), expected, atol=1e-13)
    field.real.sum().backward()
    step = np.zeros((6, 5))
    step[2, 3] = 1e-12
    difference = [_mask(height + s * step, profile="smooth").transmission(GREEN, 3).real.sum() for s in (1, -1)]
    assert tensor.grad is not None
    assert tensor.grad[2, 3].item() == pytest.approx((difference[0] - difference[1]) / 2e-12, rel=1e-3)


def test_the_heights_are_not_changed():
    height = np.random.default_rng(0).uniform(0, 1e-6, (4, 4))
    mask = _mask(height.copy(), profile="smooth")
    for oversample in (1, 2):
        mask.transmission(GREEN, oversample)
    np.testing.assert_array_equal(mask.height_m, height)


def test_a_staircase_is_repeated():
    height = np.random.default_rng(0).uniform(0, 1e-6, (3, 4))
    mask = _mask(height, height / height.max())
    np.testing.assert_array_equal(mask.transmission(GREEN, 3), np.kron(mask.transmission(GREEN), np.ones((3, 3))))


def _cosine_error(samples: int) -> float:
    """Return the largest phasor error, border left out, of a cosine of one period over 0.4 mm refined four times."""
    side = 0.4e-3

    def height(n):
        x = (np.arange(n) - (n - 1) / 2) * side / n
        return 1e-6 * np.cos(2 * np.pi * x[None, :] / side + 0.4) * np.cos(2 * np.pi * x[:, None] / side - 0.7)

    field = _mask(height(samples), pitch_m=side / samples, profile="smooth").transmission(GREEN, 4)
    reference = _mask(height(4 * samples), pitch_m=side / samples / 4).transmission(GREEN)
    inner = slice(8, -8)  # the outermost samples lack a neighbour
    return np.abs(field - reference)[inner, inner].max()


def test_a_smooth_mask_is_refined_to_third_order():
    """Keys' kernel: the error falls by 8 when the pitch is halved (measured 8.6 and 8.1), and is small."""
    errors = np.array([_cosine_error(n) for n in (32, 64, 128)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all((orders > 2.8) & (orders < 3.4)), orders
    assert errors[-1] < 2e-5


def test_a_smooth_amplitude_stays_between_zero_and_one():
    """Cubic interpolation overshoots at an edge; transmission does not."""
    amplitude = np.zeros((12, 12))
    amplitude[3:9, 3:9] = 1
    field = _mask(np.zeros((12, 12)), amplitude, profile="smooth").transmission(GREEN, 4)
    assert np.abs(field).max() <= 1
    assert field.real.min() >= 0


def test_transmitted_area_is_transmittance_times_area():
    mask = _mask(np.zeros((4, 5)), np.full((4, 5), 0.5), pitch_m=3e-6)
    assert mask.transmitted_area_m2 == pytest.approx(0.25 * 20 * 9e-12, rel=1e-12)


@pytest.mark.parametrize(
    ("shape", "wanted", "rows", "columns"),
    [
        ((8, 10), (4, 6), slice(2, 6), slice(2, 8)),
        ((9, 9), (3, 9), slice(3, 6), slice(0, 9)),
        ((5, 6), (50, 2), slice(0, 5), slice(2, 4)),
    ],
)
def test_crop_keeps_the_middle(shape, wanted, rows, columns):
    height = np.arange(np.prod(shape), dtype=float).reshape(shape) * 1e-9
    mask = Mask(height, 1 - height * 1e6, 3e-6, PHLATCAM_RESIST, "smooth", "mine").crop(wanted)
    np.testing.assert_array_equal(mask.height_m, height[rows, columns])
    np.testing.assert_array_equal(mask.amplitude, (1 - height * 1e6)[rows, columns])
    assert (mask.pitch_m, mask.material, mask.profile, mask.name) == (3e-6, PHLATCAM_RESIST, "smooth", "mine")


def test_the_digest_sees_everything_that_decides_the_transmission():
    height = np.arange(6.0).reshape(2, 3) * 1e-7
    masks = [
        _mask(height),
        _mask(height + 1e-9),
        _mask(height.reshape(3, 2)),
        _mask(height, np.full((2, 3), 0.9)),
        _mask(height, pitch_m=2.1e-6),
        _mask(height, profile="smooth"),
        _mask(height, material=PHLATCAM_RESIST),
        _mask(height.astype(np.float32)),
    ]
    assert len({mask.digest() for mask in masks}) == len(masks)
    assert _mask(height.copy()).digest() == masks[0].digest()
    # The same numbers in another memory layout are the same mask.
    assert _mask(np.asfortranarray(height)).digest() == masks[0].digest()


def test_provenance_says_what_it_is():
    record = Mask(np.zeros((2, 3)), np.ones((2, 3)), 2e-6, PHLATCAM_RESIST, name="mine").provenance()
    assert record["name"] == "mine"
    assert record["shape"] == [2, 3]
    assert record["transmitted_area_m2"] == pytest.approx(2.4e-11)
    assert "nominal" in record["material_source"]


def _flat(value=0.0, shape=(3, 3)):
    return np.full(shape, value)


@pytest.mark.parametrize(
    ("height", "amplitude", "pitch_m", "profile", "words"),
    [
        (_flat(shape=(3, 4)), _flat(1), 2e-6, "smooth", "^height_m, amplitude: "),
        (np.zeros(9), np.ones(9), 2e-6, "smooth", "^height_m, amplitude: "),
        (np.array([[0.0, np.nan], [np.inf, 0]]), _flat(1, (2, 2)), 2e-6, "smooth", "^height_m: "),
        (_flat(1e-6 + 1e-7j), _flat(1), 2e-6, "smooth", "^height_m: "),
        (_flat(), _flat(1j), 2e-6, "smooth", "^amplitude: "),
        (_flat(), _flat(1.5), 2e-6, "smooth", "^amplitude: "),
        (_flat(), _flat(-0.1), 2e-6, "smooth", "^amplitude: "),
        (_flat(), np.where(np.eye(3), np.nan, 1), 2e-6, "smooth", "^amplitude: "),
        (_flat(), _flat(0), 2e-6, "smooth", "^amplitude: "),
        (_flat(), _flat(1), 2.0, "smooth", "^pitch_m: "),
        (_flat(), _flat(1), float("nan"), "smooth", "^pitch_m: "),
        (_flat(), _flat(1), 2e-6, "rough", "^profile: "),
    ],
)
def test_senseless_masks_are_refused(height, amplitude, pitch_m, profile, words):
    with pytest.raises(InputError, match=words):
        Mask(height, amplitude, pitch_m, FUSED_SILICA, profile)


@pytest.mark.parametrize(("key", "arguments"), [("oversample", (GREEN, 0)), ("wavelength_m", (532.0,))])
def test_senseless_transmissions_are_refused(key, arguments):
    with pytest.raises(InputError, match=rf"^{key}: "):
        _mask(_flat()).transmission(*arguments)
