"""Constrained least squares: a scene of small second derivatives that explains the measurement, at each depth alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.layers.inversion import RegularisedInversion
from learning.layers.padding import as_pairs, from_pairs


class ConstrainedLeastSquares(RegularisedInversion):
    """``argmin |Y - H(z) * S|^2 + lambda(z) |P * S|^2`` for each plane z: thesis 5.2 and 5.3, where P is the Laplacian.

    Gonzalez and Woods, Digital Image Processing, section 5.9. A Tikhonov term added to the Laplacian's middle is not in the
    thesis: without it wide masks, whose FH has zeros near frequency zero, give images of the wrong brightness. The layer of
    the networks with nothing learned, so that both have the same Fourier transforms, padding and units; the division is
    worked out once.
    """

    divided: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        planes: Sequence[int] | None = None,
        *,
        regularisation_lambda: float,
        tikhonov: float,
    ) -> None:
        """Prepare the division.

        Args:
            capture: the camera.
            planes: indices of the planes to invert at; None takes all.
            regularisation_lambda: a multiple of the PSF's mean spectral power, alike for every mask, gain and exposure.
            tikhonov: Tikhonov term, the response of P at frequency zero; 0 is the Laplacian alone.

        Raises:
            InputError: a lambda that is not positive.
        """
        super().__init__(capture, planes, regularisation_lambda=regularisation_lambda, tikhonov=tikhonov, learned=False)
        # Pairs, three axes: as the layer's own spectra they follow a module to another precision or memory format unharmed.
        self.register_buffer("divided", as_pairs(super().inverse()).flatten(0, 1), persistent=False)

    def inverse(self) -> Tensor:
        """Return W(z), ``(K, C, L // 2 + 1, M)`` complex; see `RegularisedInversion.inverse`."""
        return from_pairs(self.divided).unflatten(0, self.log_lambda.shape)

    @torch.no_grad()
    def forward(self, measurement: Tensor, inverse: Tensor | None = None) -> Tensor:
        """Return ``(B, K, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        return super().forward(measurement, inverse)
