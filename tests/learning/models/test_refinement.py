"""A refinement step against its definition in NumPy with the simulator's forward model, and on scenes where it must help."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learning.layers.inversion import RegularisedInversion
from learning.models.refinement import Refinement, Surface
from simulator.colour import linear_to_srgb, srgb_to_linear


def softmax(values):
    return np.exp(values) / np.exp(values).sum(axis=1, keepdims=True)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("noise_aware", [False, True])
def test_a_step_is_its_definition(tiny_capture, recorded, noise_aware):
    """Image to planes, planes to sensor, the residual to volumes, their choice to the image; the body adds to all.

    Some pixels are brighter than a surface may be, and some have a colour that is negative in one of the camera's channels.
    """
    rng = np.random.default_rng(4)
    colours = np.array([[0.8, 0.2, -0.3], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]])
    tiny_capture = replace(tiny_capture, scene_to_camera=colours)
    options = {"regularisation_lambda": 0.2, "noise_weight": 3.0 if noise_aware else None}
    step = Refinement(tiny_capture, range(3), options, noise_aware, filters=4, levels=2)
    output = rng.normal(0, 0.3, (2, 7, 16, 16))
    step.enhancement = body = recorded(torch.from_numpy(output))
    image, disparity = rng.uniform(-0.2, 3, (2, 3, 16, 16)), rng.random((2, 1, 16, 16))
    logits, light = rng.normal(0, 2, (2, 3, 16, 16)), rng.uniform(0, 0.5, (2, 3, 48, 48))
    noise, level = (torch.full((2, 3), 0.1), torch.rand(2, 1, 16, 16)) if noise_aware else (None, None)
    before = Surface(*map(torch.from_numpy, (image, disparity, logits)))
    got = step(before, torch.from_numpy(light), noise, level)

    linear = srgb_to_linear(image.clip(0, None)).astype(float).clip(0, 4)
    weights, camera = softmax(logits), np.einsum("ca,bahw->bchw", colours, linear)
    assert (linear == 4).any()
    assert (camera < 0).any()
    camera = camera.clip(0, None)
    radiated = (
        weights[:, :, None] * camera[:, None] * tiny_capture.irradiance * (tiny_capture.gain * tiny_capture.white)
    )
    model = tiny_capture.forward_model(radiated)
    residual = light - np.stack([model.forward(each[None]) for each in radiated])
    inversion = RegularisedInversion(tiny_capture, **options)
    volume = inversion.volume(inversion.spectrum(torch.from_numpy(residual)), noise).detach().numpy()
    wanted = np.concatenate([volume, weights[:, :, None]], axis=2).reshape(2, 12, 16, 16)
    wanted = [wanted, image, disparity] + ([level.numpy()] if noise_aware else [])
    np.testing.assert_allclose(
        body.given.detach(), np.concatenate(wanted, axis=1), rtol=1e-5, atol=1e-5
    )  # colour is float32

    chosen = softmax(logits + output[:, 4:])
    added = np.einsum("ac,bkchw,bkhw->bahw", np.linalg.inv(colours), volume, chosen)
    codes = linear_to_srgb((linear + added).clip(0, 4)) - linear_to_srgb(linear)
    np.testing.assert_allclose(got.image.detach(), image + codes + output[:, :3], atol=1e-5)
    moved = np.einsum("k,bkhw->bhw", tiny_capture.plane_disparities(), chosen - weights)[:, None]
    np.testing.assert_allclose(got.disparity.detach(), disparity + moved + output[:, 3:4], atol=1e-9)
    np.testing.assert_allclose(got.logits.detach(), logits + output[:, 4:], atol=1e-12)


@pytest.mark.usefixtures("double")
def test_what_explains_all_stays_and_what_is_too_dark_is_made_brighter(tiny_capture):
    """Before anything is learned: nothing is left of a scene that explains its measurement."""
    rng = np.random.default_rng(5)
    step = Refinement(tiny_capture, range(3), {"regularisation_lambda": 1e-3}, False, filters=4, levels=2)
    image = torch.from_numpy(rng.uniform(0.3, 0.9, (1, 3, 16, 16)))
    logits = torch.zeros(1, 3, 16, 16)
    logits[:, 1] = 50.0
    truth = Surface(image, torch.full((1, 1, 16, 16), 0.5), logits)
    linear = torch.from_numpy(srgb_to_linear(image.numpy()).astype(float))
    light = step.inversion.reproject(step.choice.volume(linear, logits.softmax(dim=1)))
    same = step(truth, light, None, None)
    torch.testing.assert_close(same.image, image, atol=1e-5, rtol=0)
    torch.testing.assert_close(same.disparity, truth.disparity, atol=1e-9, rtol=0)
    darker = step(truth._replace(image=image - 0.1), light, None, None)
    assert float((darker.image.detach() - image).abs().mean()) < 0.05
