"""Gradients of PSFs with respect to heights, distance and wavelength weights, in float64, against finite differences."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from simulator.design.fabrication import quantise
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.spectra import Line
from simulator.types import CameraGeometry, SpectralResponse

torch = pytest.importorskip("torch")

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
MODELS = ["scaled_distance", "scaled_psf", "exact"]
STEP = 1e-5  # relative: central differences are then good to 1e-9, rounding to 1e-10


def stack(height_um: Any, distance_mm: Any, weights: Any, model: str, profile: str) -> Any:
    """Return the values of a tiny stack as a tensor, from numbers of order one."""
    amplitude = torch.ones((20, 22), dtype=torch.float64)
    mask = Mask(height_um * 1e-6, amplitude, 2e-6, FUSED_SILICA, profile)
    camera = CameraGeometry(distance_mm * 1e-3, 7e-6, GREEN)
    lines = [Line(0, w, weights[i]) for i, w in enumerate((500e-9, 600e-9))]
    return compute_psf_stack(mask, camera, PsfConfig((0.0031,), model), xp="torch", lines=lines).values


def loss(values: Any) -> Any:
    """Weigh the pixels unevenly, so that no gradient cancels by energy conservation."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in values.shape[-2:])
    weight = torch.sin(1 + 0.9 * y)[:, None] * torch.cos(0.7 * x)
    return torch.sum(values * weight)


def inputs() -> dict[str, Any]:
    height = torch.from_numpy(np.random.default_rng(0).uniform(0, 1, (20, 22)))
    return {
        "height_um": height,
        "distance_mm": torch.tensor(0.25, dtype=torch.float64),
        "weights": torch.tensor([0.3, 0.7]),
    }


@pytest.mark.parametrize("profile", ["staircase", "smooth"])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["height_um", "distance_mm", "weights"])
def test_gradients_equal_finite_differences(name, model, profile):
    """Along a random direction; the pixels' edges move through the grid's cells with the distance, piecewise smoothly."""
    if (name, model, profile) == ("distance_mm", "exact", "staircase"):
        return  # near the mask the orders that are followed depend on the distance: a choice without a gradient; see below
    given = {key: value.double() for key, value in inputs().items()}
    direction = torch.from_numpy(np.random.default_rng(1).standard_normal(given[name].shape))
    asked = given | {name: given[name].clone().requires_grad_(True)}
    loss(stack(**asked, model=model, profile=profile)).backward()
    slope = float(torch.sum(asked[name].grad * direction))
    there, back = (
        float(loss(stack(**(given | {name: given[name] + sign * STEP * direction}), model=model, profile=profile)))
        for sign in (1, -1)
    )
    assert slope == pytest.approx((there - back) / (2 * STEP), rel=1e-5)
    assert abs(slope) > 1e-3 * abs(there)


@pytest.mark.slow
def test_the_distance_of_an_exact_staircase_has_a_gradient():
    """At 2 mm a fixed angle bounds the orders that are followed; the soft cut's width, sqrt(d), is held fixed: 1.4e-3."""
    given = {key: value.double() for key, value in inputs().items()}
    distance = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    loss(stack(**(given | {"distance_mm": distance}), model="exact", profile="staircase")).backward()
    there, back = (
        float(loss(stack(**(given | {"distance_mm": torch.tensor(d).double()}), model="exact", profile="staircase")))
        for d in (2.0 + 1e-5, 2.0 - 1e-5)
    )
    assert float(distance.grad) == pytest.approx((there - back) / 2e-5, rel=3e-3)


def test_the_gradient_passes_straight_through_quantised_heights():
    """A loss on the PSF of quantised heights has, with respect to the heights before, the gradient at the quantised ones."""
    given = {key: value.double() for key, value in inputs().items()}
    free = given["height_um"].clone().requires_grad_(True)
    loss(stack(**(given | {"height_um": quantise(free, 0.2)}), model="exact", profile="staircase")).backward()
    fixed = quantise(given["height_um"], 0.2).clone().requires_grad_(True)
    loss(stack(**(given | {"height_um": fixed}), model="exact", profile="staircase")).backward()
    assert float(free.grad.abs().max()) > 0
    torch.testing.assert_close(free.grad, fixed.grad, rtol=1e-12, atol=0)


def test_torch_and_numpy_give_the_same_stack():
    given = inputs()
    for model, profile in product(MODELS, ("staircase", "smooth")):
        values = stack(**{k: v.double() for k, v in given.items()}, model=model, profile=profile)
        mask = Mask(given["height_um"].numpy() * 1e-6, np.ones((20, 22)), 2e-6, FUSED_SILICA, profile)
        lines = [Line(0, 500e-9, 0.3), Line(0, 600e-9, 0.7)]
        camera = CameraGeometry(0.25e-3, 7e-6, GREEN)
        again = compute_psf_stack(mask, camera, PsfConfig((0.0031,), model), lines=lines).values
        np.testing.assert_allclose(values.numpy(), again, atol=1e-7 * again.max())  # weights came as float32


def test_a_tensor_for_the_distance_does_not_change_the_identity():
    """Fingerprint and record hold the plain number."""
    config = PsfConfig((0.0031,), wavelengths_per_channel=1)
    mask = Mask(torch.zeros((20, 22)), torch.ones((20, 22)), 2e-6)
    camera = CameraGeometry(0.25e-3, 7e-6, GREEN)
    plain = compute_psf_stack(mask, camera, config, xp="torch")
    tensor = replace(camera, mask_to_sensor_m=torch.tensor(0.25e-3, dtype=torch.float64, requires_grad=True))
    again = compute_psf_stack(mask, tensor, config, xp="torch")
    assert again.fingerprint == plain.fingerprint
    assert again.provenance["mask_to_sensor_m"] == 0.25e-3
    assert again.values.requires_grad
