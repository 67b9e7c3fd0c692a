"""An unfolded network of deepinv, trained for a few steps on captures of a lensless camera.

Two steps of half-quadratic splitting, each with a small network in place of the prior: least squares with the camera's own
operator, by deepinv's solver with its implicit gradient, then a network. It learns from crops of seven pictures and is tested
on one that it has not seen, beside its own first guess. Needs the extras `deepinv` and `learn`.
"""

import sys
from pathlib import Path

import numpy as np
import skimage.data
import torch
from deepinv.models import DnCNN
from deepinv.optim import HQS, L2, PnP
from deepinv_pnp import SCENE, lensless_camera, picture, psnr, write_row

from learning.deepinv_physics import as_physics
from simulator.colour import srgb_to_linear

STEPS, BATCH, UNFOLDED = 100, 4, 2
TRAINING = ("coffee", "chelsea", "rocket", "hubble_deep_field", "immunohistochemistry", "retina", "colorwheel")


class Residual(torch.nn.Module):
    """deepinv's DnCNN, which starts as the identity: what it adds is scaled by zero at first."""

    def __init__(self):
        """Draw its weights."""
        super().__init__()
        self.body = DnCNN(3, 3, depth=5, nf=24, pretrained=None)
        self.gain = torch.nn.Parameter(torch.zeros(1))

    def forward(self, image, sigma=None):
        """Return the image `(B, 3, h, w)` with what was learned added; the noise level is not used."""
        return image + self.gain * self.body(image)


def crops(images, rng):
    """Return random crops, flipped at random, of pictures in linear light, `(B, 3, h, w)`."""
    chosen = []
    for _ in range(BATCH):
        image = images[rng.integers(len(images))]
        top, left = (rng.integers(n - size + 1) for n, size in zip(image.shape[1:], SCENE, strict=True))
        crop = image[:, top : top + SCENE[0], left : left + SCENE[1]]
        chosen.append(crop.flip(-1) if rng.random() < 0.5 else crop)
    return torch.stack(chosen)


def training_pictures():
    """Return pictures of scikit-image in linear light, a quarter as large, `(3, h, w)`."""
    linear = [srgb_to_linear(getattr(skimage.data, name)()[..., :3].astype(np.float32) / 255) for name in TRAINING]
    images = [torch.from_numpy(np.moveaxis(each, -1, 0).astype(np.float32))[None] for each in linear]
    return [torch.nn.functional.avg_pool2d(each, max(1, min(each.shape[-2:]) // 128))[0] for each in images]


def main(folder, steps=STEPS):
    """Train, and write the test picture's capture, first guess and reconstruction beside the truth."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    model, sensor = lensless_camera()
    physics = as_physics(model, sensor=sensor)
    physics.max_iter = 20  # of the least squares in each step
    network = HQS(
        data_fidelity=L2(),
        prior=[PnP(denoiser=Residual()) for _ in range(UNFOLDED)],
        stepsize=[1000.0] * UNFOLDED,
        sigma_denoiser=[0.1] * UNFOLDED,
        max_iter=UNFOLDED,
        unfold=True,
        trainable_params=["stepsize"],
    )
    truth = picture("astronaut")[None]
    capture = physics(truth)
    images = training_pictures()
    with torch.no_grad():
        first = network(capture, physics)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    for step in range(steps):
        batch = crops(images, rng)
        loss = (network(physics(batch), physics) - batch).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 20 == 0:
            print(f"step {step}: mean absolute error {loss.item():.4f}")
    with torch.no_grad():
        found = network(capture, physics)
    scores = {"before training": psnr(first, truth), "after training": psnr(found, truth)}
    for name, score in scores.items():
        print(f"{name}: {score:.2f} dB")
    shown = torch.nn.functional.interpolate(capture, SCENE)[0]
    write_row(folder / "deepinv_unfolded.png", [truth[0], shown / shown.max(), first[0], found[0]])
    return scores


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
