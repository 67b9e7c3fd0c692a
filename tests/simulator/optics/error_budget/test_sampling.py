"""The sampling proof: its number is the real difference, and its limits warn and refuse with a cure that works."""

import re
import warnings

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.error_budget.budget import proven_psf_stack
from simulator.optics.error_budget.sampling import CROP_M, REFUSE, WARN, prove_sampling, sampling_error
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.stack import UNPROVEN
from simulator.types import CameraGeometry, SpectralResponse

pytestmark = pytest.mark.filterwarnings("ignore::simulator.optics.error_budget.sampling.SamplingWarning")
D, PITCH = 0.2e-3, 6e-6


def _camera(*wavelengths_nm, pitch_m=PITCH):
    """One channel per wavelength, each a narrow line."""
    at = np.arange(400, 701) * 1e-9
    weights = np.array([np.isclose(at, w * 1e-9, atol=1e-12).astype(float) for w in wavelengths_nm])
    return CameraGeometry(D, pitch_m, SpectralResponse(at, weights, tuple("RGB"[: len(weights)]), "lines"))


def _staircase(samples=40, levels=6, pitch_m=2e-6):
    height = np.random.default_rng(0).integers(0, levels, (samples, samples)) * 0.2e-6
    return Mask(height, np.ones_like(height), pitch_m)


def _smooth(samples=40, turns=0.05, pitch_m=2e-6):
    """A round bump under a soft aperture; its phase turns by at most ``turns`` per sample at 532 nm."""
    x = (np.arange(samples) - (samples - 1) / 2) / samples
    bump = np.cos(2 * np.pi * x[:, None]) * np.cos(2 * np.pi * x[None, :])
    steepest = max(np.abs(np.diff(bump, axis=axis)).max() for axis in (0, 1))
    height = bump * turns * 532e-9 / (FUSED_SILICA.index(532e-9) - 1) / steepest
    aperture = np.exp(-((np.hypot(x[:, None], x[None, :]) / 0.4) ** 12))
    return Mask(height, aperture, pitch_m, profile="smooth")


def _values(mask, camera, depth_m, oversampling):
    config = PsfConfig((depth_m,), wavelengths_per_channel=1, oversampling=oversampling)
    return np.asarray(compute_psf_stack(mask, camera, config).values[0, 0])


def _difference(mask, camera, depth_m, oversampling):
    """The relative L2 difference of two whole stacks; the finer one may follow the light farther out."""
    coarse, fine = (_values(mask, camera, depth_m, s) for s in (oversampling, 2 * oversampling))
    margin = (len(fine) - len(coarse)) // 2
    return np.linalg.norm(np.pad(coarse, margin) - fine) / np.linalg.norm(fine)


@pytest.mark.parametrize("mask", [_staircase(), _smooth(turns=0.2)], ids=["staircase", "smooth"])
def test_the_reported_error_is_the_difference_of_the_stacks(mask):
    """Masks below the crop's size: the table's rows are what anybody gets by computing both stacks.

    Where the finer stack follows steeper light, that light is part of the report but not of the coarse stack.
    """
    depths = (0.02, 0.05, np.inf)
    report = sampling_error(mask, _camera(450, 532, 620), PsfConfig(depths, wavelengths_per_channel=1))
    assert [(round(row["wavelength_m"] * 1e9), row["depth_m"]) for row in report["table"]] == [
        (450, 0.02),
        (450, np.inf),
    ]
    for row in report["table"]:
        camera = _camera(round(row["wavelength_m"] * 1e9))
        expected = _difference(mask, camera, row["depth_m"], 1)
        assert row["error"] == pytest.approx(expected, rel=1e-3)
    assert report["error"] == max(row["error"] for row in report["table"])
    assert report["oversampling"] == [1, 2]
    assert report["error_bar"] == 2 * report["error"]


def test_a_large_mask_is_judged_by_its_middle():
    """The rim has other heights; it must not count."""
    samples = round(CROP_M / 10e-6)
    inner = _staircase(samples, pitch_m=10e-6)
    height = np.pad(inner.height_m, 20, constant_values=0.123e-6)
    large = Mask(height, np.ones_like(height), 10e-6)
    config = PsfConfig((np.inf,), wavelengths_per_channel=1)
    whole, middle = (sampling_error(mask, _camera(532, pitch_m=20e-6), config) for mask in (large, inner))
    assert whole == middle
    assert whole["crop_m"] == pytest.approx(CROP_M)


def test_more_samples_err_less():
    first, second, third = (
        sampling_error(_staircase(), _camera(532), PsfConfig((np.inf,), oversampling=s))["error"] for s in (1, 2, 4)
    )
    assert first > 1.5 * second > 2 * third > 0


def test_the_stack_records_the_report():
    config = PsfConfig((0.05, np.inf), wavelengths_per_channel=1, accept_error=10.0)
    stack = proven_psf_stack(_staircase(), _camera(532), config)
    assert stack.provenance["sampling"] == sampling_error(_staircase(), _camera(532), config)
    pure = compute_psf_stack(_staircase(), _camera(532), config)
    assert pure.provenance["sampling"] == UNPROVEN
    np.testing.assert_array_equal(pure.values, stack.values)


@pytest.fixture(scope="module")
def graded():
    """Return staircase masks whose errors lie below the warning, between the limits and above them: (mask, camera, error)."""
    config = PsfConfig((np.inf,), wavelengths_per_channel=1)
    found = {}
    coarse = _staircase(8)
    blocks = Mask(*(np.kron(part, np.ones((5, 5))) for part in (coarse.height_m, coarse.amplitude)), coarse.pitch_m)
    for mask, pitch_um in ((blocks, 60), (blocks, 20), (_staircase(), 60), (_staircase(), 14), (_staircase(), 6)):
        camera = _camera(532, pitch_m=pitch_um * 1e-6)
        error = sampling_error(mask, camera, config)["error"]
        found["ok" if error < WARN else "warned" if error < REFUSE else "refused"] = (mask, camera, error)
    return found


def _prove(case, **settings):
    mask, camera, _ = case
    return prove_sampling(mask, camera, PsfConfig((np.inf,), wavelengths_per_channel=1, **settings))


def test_a_small_error_passes_silently(graded):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _prove(graded["ok"])["error"] < WARN


def test_a_middling_error_is_warned_about_with_its_number(graded):
    error = graded["warned"][2]
    with pytest.warns(UserWarning, match=f"{error:.3f}") as caught:
        assert _prove(graded["warned"])["error"] == error
    assert len(caught) == 1


def test_a_large_error_is_refused_with_a_cure_that_works(graded):
    """Following the message's advice leads to a stack within three steps."""
    mask, camera, _ = graded["refused"]
    oversampling = 1
    with pytest.raises(InputError, match=r"^oversampling: "):
        _prove(graded["refused"])
    for _ in range(3):
        config = PsfConfig((np.inf,), wavelengths_per_channel=1, oversampling=oversampling)
        try:
            prove_sampling(mask, camera, config)
        except InputError as refusal:
            oversampling = int(re.search(r"use oversampling (\d+)", str(refusal))[1])
        else:
            break
    else:
        pytest.fail(f"still refused at oversampling {oversampling}")
    assert oversampling > 1


def test_accept_error_is_the_limit(graded):
    """It lets a large error pass, with a warning, and makes a small one a refusal."""
    error = graded["refused"][2]
    with pytest.warns(UserWarning, match="sampling error"):
        assert _prove(graded["refused"], accept_error=1.01 * error)["error"] == error
    with pytest.raises(InputError, match=r"^oversampling: "):
        _prove(graded["refused"], accept_error=0.99 * error)
    with pytest.raises(InputError, match=r"^oversampling: "):
        _prove(graded["warned"], accept_error=0.001)


def test_a_steep_smooth_mask_is_refused_with_a_cure_that_works():
    """0.8 turns per sample at 532 nm, 0.95 at 450 nm: beyond half a turn the grid holds another mask."""
    mask = _smooth(turns=0.8)
    with pytest.raises(InputError, match=r"^oversampling: ") as refusal:
        prove_sampling(mask, _camera(450, 532), PsfConfig((np.inf,), wavelengths_per_channel=1))
    needed = int(re.search(r"use oversampling (\d+)", str(refusal.value))[1])
    assert needed == 2
    config = PsfConfig((np.inf,), wavelengths_per_channel=1, oversampling=needed, accept_error=10.0)
    assert np.isfinite(prove_sampling(mask, _camera(450, 532), config)["error"])


@pytest.mark.parametrize(("turns", "cure"), [(0.6, "use oversampling 2"), (20, r"finer samples \(pixel_um\)")])
def test_accept_error_does_not_excuse_steep_phase(turns, cure):
    """Of 20 turns per sample, no oversampling that a configuration may ask for would do."""
    config = PsfConfig((np.inf,), wavelengths_per_channel=1, accept_error=10.0)
    with pytest.raises(InputError, match=rf"^oversampling: .*{cure}"):
        prove_sampling(_smooth(turns=turns), _camera(532), config)


def test_steps_of_whole_turns_are_no_steepness_on_a_staircase():
    """The published masks step by more than half a turn on every fifth pixel; that is light, not error."""
    wave = 532e-9 / (FUSED_SILICA.index(532e-9) - 1)
    height = np.random.default_rng(0).integers(0, 2, (40, 40)) * wave
    config = PsfConfig((np.inf,), wavelengths_per_channel=1, accept_error=10.0)
    flat, stepped = (prove_sampling(Mask(h, np.ones_like(h), 2e-6), _camera(532), config) for h in (0 * height, height))
    assert stepped["error"] == pytest.approx(flat["error"], rel=1e-6)


def test_a_mask_that_is_dark_in_the_middle_is_judged_where_it_is_open():
    amplitude = np.ones((220, 220))
    amplitude[20:200, 20:200] = 0
    mask = Mask(np.zeros_like(amplitude), amplitude, 10e-6)
    report = sampling_error(mask, _camera(532, pitch_m=20e-6), PsfConfig((np.inf,), wavelengths_per_channel=1))
    assert report["crop_m"] == pytest.approx(1.5e-3)
    assert np.isfinite(report["error"])
