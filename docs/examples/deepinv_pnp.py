"""Plug-and-play with deepinv on a lensless camera, beside our own methods, at the same capture.

deepinv brings the solver (half-quadratic splitting, as in DPIR), Flatlight the camera and the denoiser: a small network for
pictures in linear light that is shipped with it, so that nothing is downloaded. Needs the extras `deepinv` and `learn`.
"""

import sys
from pathlib import Path

import numpy as np
import skimage.data
import skimage.transform
import torch
from deepinv.optim import HQS, L2, PnP
from PIL import Image

from learning.camera import plain_capture
from learning.checkpoint import DENOISER, FOLDER, load_denoiser
from learning.classical.method import PlanarMethod
from learning.deepinv_physics import as_physics
from psf_library import load_mask
from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise
from simulator.camera.sensor import Sensor
from simulator.colour import linear_to_srgb, srgb_to_linear
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.spectra import spectral_response
from simulator.types import CameraGeometry

SCENE, SENSOR, NOISE = (64, 64), (128, 128), 0.003
# The best on a coarse grid, against this picture's truth: weights of total variation and prior; of the data, last level.
TV, PRIOR, DATA, LAST = 0.05, 1.0, 2.0, 0.03


def lensless_camera():
    """Return the model of a camera with a PhlatCam mask of 1 mm, and its sensor: Gaussian noise, 0.3 % of full scale."""
    mask = load_mask("phlatcam", width_mm=1.0)
    geometry = CameraGeometry(1.9e-3, 19.2e-6, spectral_response())
    model = ForwardModel(compute_psf_stack(mask, geometry, PsfConfig((0.3,))), SENSOR, SCENE)
    brightest = model.forward(np.ones((1, 1, 3, *SCENE), np.float32)).max()
    sensor = Sensor(
        name="a sensor of 128 x 128",
        pixel_pitch_m=19.2e-6,
        physical_shape=SENSOR,
        binning=1,
        shape=SENSOR,
        full_well_e=15000,
        read_noise_e=3,
        row_noise_e=0,
        dark_current_e_per_s=0,
        prnu=0,
        black_level_dn=0,
        bit_depth=12,
        full_scale=float(brightest),
        noise=GaussianNoise(std=NOISE),
    )
    return model, sensor


def picture(name):
    """Return a picture of scikit-image in linear light, `(3, h, w)` float32."""
    codes = skimage.transform.resize(getattr(skimage.data, name)(), SCENE, anti_aliasing=True)
    return torch.from_numpy(np.moveaxis(srgb_to_linear(codes), -1, 0).astype(np.float32))


def psnr(found, truth):
    """Return the PSNR of sRGB codes, dB."""
    codes = [linear_to_srgb(image.detach().numpy().clip(0, 1)) for image in (found, truth)]
    return -10 * np.log10(np.mean((codes[0] - codes[1]) ** 2))


def write_row(path, images):
    """Write images `(3, h, w)` in linear light side by side, four times as large."""
    codes = [np.moveaxis(linear_to_srgb(image.detach().numpy().clip(0, 1)), 0, -1) for image in images]
    row = np.concatenate([np.kron(code, np.ones((4, 4, 1))) for code in codes], axis=1)
    Image.fromarray(np.rint(255 * row).astype(np.uint8)).save(path)


def main(folder):
    """Capture one picture, reconstruct it twice, and write both beside the truth."""
    torch.manual_seed(0)
    model, sensor = lensless_camera()
    physics = as_physics(model, sensor=sensor)
    truth = picture("astronaut")[None]
    capture = physics(truth)

    # Plug and play: the noise that the denoiser takes away falls from step to step, and with it the prior's weight.
    network, _ = load_denoiser(FOLDER / f"{DENOISER}.safetensors")

    def denoiser(images, sigma, **_):
        return network.planes(images[:, None], torch.as_tensor(sigma).float().reshape(-1).expand(len(images)))[:, 0]

    steps, noise = 10, float(physics.noise_model.sigma)
    sigmas = np.geomspace(0.3, LAST, steps, dtype=np.float32)
    solver = HQS(
        data_fidelity=L2(),
        prior=PnP(denoiser=denoiser),
        stepsize=list(DATA * (sigmas / noise) ** 2),
        sigma_denoiser=list(sigmas),
        max_iter=steps,
        early_stop=False,
    )
    with torch.no_grad():
        plugged = solver(capture, physics).clamp_min(0)

    # Our own, from the measurement in the model's unit, A x norm: total variation, and the same denoiser in our solver.
    chosen = {"admm": {"tv": TV, "sparsity": 0.0, "iterations": 150}, "pnp": {"prior": PRIOR}}
    own = plain_capture(model.stack, SENSOR, SCENE)
    found = {"plug and play (deepinv)": plugged}
    for name, label in (("admm", "ADMM-TV (ours)"), ("pnp", "plug and play (ours)")):
        method = PlanarMethod(own, name, chosen[name] | {"light": "scene"})
        found[label] = method.volume(capture * physics.norm)[:, 0]
    scores = {label: psnr(image, truth) for label, image in found.items()}
    for name, score in scores.items():
        print(f"{name}: {score:.2f} dB")
    shown = torch.nn.functional.interpolate(capture, SCENE)[0]
    write_row(folder / "deepinv_pnp.png", [truth[0], shown / shown.max(), *(image[0] for image in found.values())])
    return scores


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
