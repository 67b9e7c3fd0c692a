"""How likely an estimated depth is right, pixel by pixel: from what the estimate itself shows, calibrated on known scenes.

Where there is no light, or nothing that changes with depth, no method can know it; some of them guess well all the same. So
nothing is assumed of what makes a depth uncertain: a logistic regression learns it from light, texture and roughness of the
estimate around a pixel and from the noise of the measurement, on scenes whose depth is known. Its output is a probability,
which can be shown to be right: of all pixels with a confidence of 0.8, four in five are.

Sources: Platt, Probabilistic outputs for support vector machines, in Advances in Large Margin Classifiers (1999), for the
calibration of a finished method; Guo et al., On Calibration of Modern Neural Networks, ICML 2017, for its error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import combinations_with_replacement
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.focus import gaussian_mean
from learning.layers.noise import noise_ratio
from learning.method import Estimate, srgb_to_linear

TOLERANCE = 0.1
"""A depth is right if its disparity errs by no more than this share of the range between the nearest and farthest plane."""
UNKNOWN = 0.5
"""A depth is given as unknown where it is rather wrong than right."""
DARK = 0.01
"""As a share of white: where the image is darker, depth cannot be estimated; what methods leave there is noise."""
FEATURES = ("light", "texture", "roughness", "noise", "disparity")
_STATISTICS = ("means", "deviations", "lowest", "highest")
_PRODUCTS = tuple(map(list, zip(*combinations_with_replacement(range(len(FEATURES)), 2), strict=True)))
_WINDOW_PX = 1.5  # standard deviation
_LEAST = 2.0**-10  # of white, of codes and of the range of disparity
_LEAST_NOISE = 1e-8
_RIDGE = 1e-4  # of the weights, per pixel: features may say the same


@dataclass(frozen=True)
class DepthConfidence:
    """A calibrated confidence of the depths of one method.

    Attributes:
        weights: of 1, of the `FEATURES` and of their products, ``(21,)``.
        means, deviations, lowest, highest: of the features where it was calibrated, ``(5,)``; beyond these ends they count
            as the ends.
        tolerance: see `TOLERANCE`.
        origin: the scenes that it was calibrated on, in words.
    """

    weights: tuple[float, ...]
    means: tuple[float, ...]
    deviations: tuple[float, ...]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    tolerance: float
    origin: str

    def record(self) -> dict[str, Any]:
        """Return it JSON-serialisable, for `read`."""
        return asdict(self)

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> Self:
        """Return what was recorded; a ValueError, TypeError or KeyError says that it is damaged."""
        sizes = {"weights": len(_PRODUCTS[0]) + len(FEATURES) + 1} | dict.fromkeys(_STATISTICS, len(FEATURES))
        numbers = {name: tuple(map(float, record[name])) for name in sizes}
        if any(len(numbers[name]) != size or not np.isfinite(numbers[name]).all() for name, size in sizes.items()):
            msg = "numbers are missing or not finite"
            raise ValueError(msg)
        return cls(**numbers, tolerance=float(record["tolerance"]), origin=str(record["origin"]))

    def of(self, estimate: Estimate, measurement: Tensor, capture: CaptureModel) -> Tensor:
        """Return the probability that each depth is right, like ``estimate.disparity``.

        ``measurement`` is what the estimate was made of, ``(B, C, H, W)`` DN / 2^bits.
        """
        found = features(estimate, measurement, capture)
        low, high, means, deviations, weights = (
            found.new_tensor(each) for each in (self.lowest, self.highest, self.means, self.deviations, self.weights)
        )
        return torch.sigmoid(_terms((found.clamp(low, high) - means) / deviations) @ weights)


def features(estimate: Estimate, measurement: Tensor, capture: CaptureModel) -> Tensor:
    """Return what a depth's confidence follows from, ``(B, [N,] 1, h, w, 5)``, see `FEATURES`; disparity as it is.

    Logarithms of: mean light of the window, of white; standard deviation of its luminance in sRGB codes; that of its
    disparities; ratio of noise to signal.
    """
    image, disparity = estimate.clamped()
    luminance = image.mean(dim=-3, keepdim=True)
    light = _window(srgb_to_linear(luminance, 1.0))
    noise = noise_ratio(measurement - measurement.new_tensor(capture.offset)[:, None, None]).mean(dim=1)
    spread = noise.clamp_min(_LEAST_NOISE).log10().reshape(-1, *[1] * (disparity.ndim - 1)).expand_as(disparity)
    logs = [values.clamp_min(_LEAST).log2() for values in (light, _deviation(luminance), _deviation(disparity))]
    return torch.stack([*logs, spread.to(light), disparity], dim=-1)


def mean_light(radiance: Tensor) -> Tensor:
    """Return the mean radiance ``(..., 1, h, w)`` around each pixel of ``(..., 3, h, w)``, over the features' window."""
    return _window(radiance.mean(dim=-3, keepdim=True))


def is_right(estimate: Estimate, disparity: Tensor) -> Tensor:
    """Return where the depth of an estimate is right by `TOLERANCE`, bool, for the true ``disparity``."""
    return (estimate.clamped().disparity - disparity).abs() <= TOLERANCE


def calibrate(examples: Iterable[tuple[NDArray[np.floating], NDArray[np.bool_]]], origin: str) -> DepthConfidence:
    """Return the confidence that explains best which depths are right.

    Args:
        examples: `features` ``(P, 5)`` of pixels, and which of their depths are right ``(P,)``, bool.
        origin: the scenes, in words.
    """
    found, right = (np.concatenate(parts) for parts in zip(*examples, strict=True))
    means, deviations = found.mean(axis=0), np.maximum(found.std(axis=0), 1e-6)
    terms = _terms(torch.from_numpy((found - means) / deviations)).numpy()
    weights = _logistic(terms, right)
    numbers = (weights, means, deviations, found.min(axis=0), found.max(axis=0))
    weights, *statistics = (tuple(map(float, each)) for each in numbers)
    return DepthConfidence(weights, *statistics, tolerance=TOLERANCE, origin=origin)  # pyright: ignore[reportCallIssue]


def _logistic(terms: NDArray[np.float64], right: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the weights of most likelihood, with a ridge."""
    from scipy.optimize import minimize

    signs = np.where(right, 1.0, -1.0)

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        margins = signs * (terms @ weights)
        slopes = -signs * np.exp(-np.logaddexp(0, margins))
        return (
            float(np.logaddexp(0, -margins).mean() + _RIDGE * weights @ weights / 2),
            terms.T @ slopes / len(terms) + _RIDGE * weights,
        )

    return minimize(loss, np.zeros(terms.shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 500}).x


def _terms(standard: Tensor) -> Tensor:
    """Return 1, the features and their products, ``(..., 21)``."""
    products = standard[..., _PRODUCTS[0]] * standard[..., _PRODUCTS[1]]
    return torch.cat([torch.ones_like(standard[..., :1]), standard, products], dim=-1)


def _window(values: Tensor) -> Tensor:
    return gaussian_mean(values, _WINDOW_PX)


def _deviation(values: Tensor) -> Tensor:
    return (_window(values.square()) - _window(values).square()).clamp_min(0).sqrt()
