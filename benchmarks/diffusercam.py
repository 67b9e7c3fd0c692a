"""CPU seconds until a real capture is explained equally well: our ADMM of one plane, and the algorithm as it was published.

    uv run --extra learn python benchmarks/diffusercam.py FOLDER [--pictures OUT] [--rounds 5]

FOLDER holds ``psf_sample.tif`` and ``rawdata_hand_sample.tif`` of the authors' tutorial: a hand before DiffuserCam. Both get
the same images: the PSF's dark corner subtracted, the PSF clipped at zero, both binned, each divided by its norm. The
published algorithm is that of the tutorial, in NumPy, with its numbers and its FFTs on twice the sensor (Antipa et al.,
Optica 5, 2018); ours has the defaults of `flatlight reconstruct --method admm`. Times begin with the images in memory and end
with the estimate: set-up included.

Data residual: |y - crop(h * x)| / |y| in float64, x the light on the whole period, none of it negative: for the published
algorithm the better of its image as it is shown, clipped at zero, and its non-negative copy; for ours the copy. Ours takes as
many iterations as it needs to come below it for good. One thread, by turns; ratios are medians over the rounds.

With --pictures: the published image after 40 iterations, ours with its default, ours after 1000, side by side.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import common
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from learning.camera import CaptureModel, plain_capture, typical_white
from learning.classical.admm import Admm
from learning.classical.method import PLANAR_DEFAULTS
from simulator.io.measurements import read_measurement
from simulator.optics.stack import PsfStack

MOST_ITERATIONS = 60
DEFAULT = int(PLANAR_DEFAULTS["admm"]["iterations"])
Values = NDArray[np.float64]


class Published:
    """ADMM in the variables of the publication: image v, copies x, u, w, multipliers xi, eta, rho."""

    MU1, MU2, MU3, TAU = 1e-6, 1e-5, 4e-5, 1e-4  # the tutorial's

    def __init__(self, psf: Values, measurement: Values) -> None:
        self.margins = [(n // 2, n // 2) for n in psf.shape]
        self.measurement = self.padded(measurement)
        self.transfer = np.fft.fft2(np.fft.ifftshift(self.padded(psf)))
        shape = self.measurement.shape
        self.x_division = 1 / (self.padded(np.ones(psf.shape)) + self.MU1)
        laplacian = np.zeros(shape)
        laplacian[0, 0] = 4
        laplacian[0, [1, -1]] = laplacian[[1, -1], 0] = -1
        slopes = np.abs(np.fft.fft2(laplacian))
        self.v_division = 1 / (self.MU1 * np.abs(self.transfer) ** 2 + self.MU2 * slopes + self.MU3)
        self.v, self.w, self.xi, self.rho = (np.zeros(shape) for _ in range(4))
        self.eta = np.zeros((2, *shape))

    def padded(self, image: Values) -> Values:
        """Return an image amid zeros, on twice the sensor."""
        return np.pad(image, self.margins)

    def seen(self, v: Values) -> Values:
        """Return h * v around the period."""
        return np.fft.fftshift(np.fft.ifft2(np.fft.fft2(np.fft.ifftshift(v)) * self.transfer)).real

    def seen_adjoint(self, x: Values) -> Values:
        """Return the adjoint of `seen`."""
        return np.fft.fftshift(np.fft.ifft2(np.fft.fft2(np.fft.ifftshift(x)) * np.conj(self.transfer))).real

    def gradient(self, v: Values) -> Values:
        """Return the differences to the neighbours above and to the left, around the period."""
        return np.stack([np.roll(v, 1, axis) - v for axis in (0, 1)])

    def gradient_adjoint(self, u: Values) -> Values:
        """Return the adjoint of `gradient`."""
        return np.roll(u[0], -1, 0) - u[0] + np.roll(u[1], -1, 1) - u[1]

    def step(self) -> None:
        """Go on by one iteration."""
        mu1, mu2, mu3 = self.MU1, self.MU2, self.MU3
        sloped = self.gradient(self.v) + self.eta / mu2
        u = np.sign(sloped) * np.maximum(np.abs(sloped) - self.TAU / mu2, 0)
        x = self.x_division * (self.xi + mu1 * self.seen(self.v) + self.measurement)
        right = (
            mu3 * self.w - self.rho + self.gradient_adjoint(mu2 * u - self.eta) + self.seen_adjoint(mu1 * x - self.xi)
        )
        self.v = np.fft.fftshift(np.fft.ifft2(self.v_division * np.fft.fft2(np.fft.ifftshift(right)))).real
        self.w = np.maximum(self.rho / mu3 + self.v, 0)
        self.xi = self.xi + mu1 * (self.seen(self.v) - x)
        self.eta = self.eta + mu2 * (self.gradient(self.v) - u)
        self.rho = self.rho + mu3 * (self.v - self.w)


class Hand:
    """PSF and measurement at a binning, and what both methods make of them."""

    def __init__(self, folder: Path, binning: int) -> None:
        psf, raw = (read_measurement(folder / f"{name}_sample.tif", ("grey",))[0] for name in ("psf", "rawdata_hand"))
        background = psf[5:15, 5:15].mean()
        self.psf, self.measurement = (
            self._prepared(image, binning) for image in ((psf - background).clip(0), raw - background)
        )
        stack = PsfStack(self.psf[None, None], np.array([np.inf]), 6e-6 * binning, ("grey",), "measured")
        unit = plain_capture(stack, self.measurement.shape)
        self.capture: CaptureModel = replace(unit, white=typical_white(unit, self.measurement[None]))

    @staticmethod
    def _prepared(image: Values, binning: int) -> Values:
        rows, columns = (size // binning for size in image.shape)
        small = image.reshape(rows, binning, columns, binning).mean(axis=(1, 3))
        return small / np.linalg.norm(small)

    def published(self, iterations: int) -> Published:
        """Return the published algorithm after some iterations."""
        method = Published(self.psf, self.measurement)
        for _ in range(iterations):
            method.step()
        return method

    def ours(self, iterations: int) -> Values:
        """Return light on the whole period, in the unit of the measurement; the sensor begins at its first sample."""
        method = Admm(self.capture, **PLANAR_DEFAULTS["admm"] | {"iterations": iterations})
        light = method.light(torch.from_numpy(self.measurement)[None, None])
        return light[0, 0, 0].numpy().astype(np.float64) * self.capture.white

    def residual(self, light: Values) -> float:
        """Return the data residual of light on a period of twice the sensor, the sensor at its first sample."""
        kernel = np.zeros(light.shape)
        kernel[: self.psf.shape[0], : self.psf.shape[1]] = self.psf
        kernel = np.roll(kernel, [-(n // 2) for n in self.psf.shape], axis=(0, 1))
        seen = np.fft.irfft2(np.fft.rfft2(light) * np.fft.rfft2(kernel), light.shape)
        rows, columns = self.measurement.shape
        return float(np.linalg.norm(seen[:rows, :columns] - self.measurement))

    @staticmethod
    def in_front(method: Published, light: Values) -> Values:
        """Return light of the published algorithm, the sensor moved to the first sample."""
        return np.roll(light, [-before for before, _ in method.margins], axis=(0, 1))

    def published_residuals(self, method: Published) -> tuple[float, float]:
        """Return the residual without negative light, and that of the image as it is, negative light included."""
        estimates = (method.v.clip(0), method.w, method.v)
        shown, copy, signed = (self.residual(self.in_front(method, light)) for light in estimates)
        return min(shown, copy), signed

    def picture(self, light: Values) -> NDArray[np.uint8]:
        """Return the scene within light on the period, upright, its brightest half per cent white."""
        scene = light[: self.measurement.shape[0], : self.measurement.shape[1]]
        codes = (scene / np.percentile(scene, 99.5)).clip(0, 1) ** (1 / 2.2)
        return np.round(255 * codes).astype(np.uint8)


def compare(hand: Hand, rounds: int) -> None:
    """Print the table of one binning."""
    ours = [hand.residual(hand.ours(n)) for n in range(1, MOST_ITERATIONS + 1)]
    print(
        "  published                                          flatlight                         published / flatlight"
    )
    print("  iterations  residual  (with negative light)  CPU s  iterations  residual  CPU s")
    for iterations in (5, 10, 20, 40):
        reached, signed = hand.published_residuals(hand.published(iterations))
        needed = 1 + max((n for n, value in enumerate(ours, 1) if value > reached), default=0)
        if needed > MOST_ITERATIONS:
            print(f"  {iterations:10}  {reached:8.4f}  {signed:21.4f}         not reached by flatlight")
            continue
        contenders = {"published": lambda n=iterations: hand.published(n), "flatlight": lambda n=needed: hand.ours(n)}
        errors = {"published": reached, "flatlight": ours[needed - 1]}
        theirs, own = common.rows(common.measure(contenders, rounds), errors, "flatlight")
        print(
            f"  {iterations:10}  {reached:8.4f}  {signed:21.4f}  {theirs.seconds:5.3f}"
            f"  {needed:10}  {own.error:8.4f}  {own.seconds:5.3f}  {theirs.ratio:20.2f}"
        )
    seconds = np.median(common.measure({"flatlight": lambda: hand.ours(DEFAULT)}, rounds)["flatlight"])
    print(f"  flatlight's default: {DEFAULT} iterations, residual {ours[DEFAULT - 1]:.4f}, {seconds:.3f} CPU s")


def draw(hand: Hand, path: Path) -> None:
    """Write the pictures side by side."""
    method = hand.published(40)
    shown = hand.in_front(method, method.v.clip(0))
    pictures = [hand.picture(light) for light in (shown, hand.ours(DEFAULT), hand.ours(1000))]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(pictures, axis=1)).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args()
    common.single_threaded()
    print(common.versions("numpy", "torch"))
    for binning in (8, 4):
        hand = Hand(chosen.folder, binning)
        print(f"\nbinning {binning}: {hand.measurement.shape[0]} x {hand.measurement.shape[1]} pixels")
        compare(hand, chosen.rounds)
        if chosen.pictures is not None:
            draw(hand, chosen.pictures / f"hand_{binning}.png")


if __name__ == "__main__":
    main()
