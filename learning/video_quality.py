"""ColorVideoVDP: how much of a film's errors a viewer sees, flicker and false motion included."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

import torch
from torch import Tensor

from learning.perceptual import PIXELS_PER_DEGREE
from simulator.plots.drawing import FRAMES_PER_SECOND


class VideoQuality:
    """ColorVideoVDP of Mantiuk et al., SIGGRAPH 2024, of the ``cvvdp`` package: just-objectionable differences, 10 is equal.

    The display is the package's ``standard_4k`` (sRGB, 200 cd/m^2 in an office), seen at FLIP's distance.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        """Build the metric; ImportError where the package is not installed."""
        import pycvvdp  # pyright: ignore[reportMissingImports]
        from pycvvdp.display_model import vvdp_display_geometry  # pyright: ignore[reportMissingImports]

        # Size and distance count by the pixels per degree alone, which the package would work out of them.
        geometry = vvdp_display_geometry([3840, 2160], ppd=PIXELS_PER_DEGREE)
        self._metric = pycvvdp.cvvdp(
            display_name="standard_4k", display_geometry=geometry, device=torch.device(device), quiet=True
        )

    @torch.no_grad()
    def __call__(self, film: Tensor, truth: Tensor) -> Tensor:
        """Return the JOD ``(B,)`` of films ``(B, N, 3, h, w)``, sRGB codes 0..1."""
        pairs = zip(film.float(), truth.float(), strict=True)
        rates = {"dim_order": "FCHW", "frames_per_second": FRAMES_PER_SECOND}
        with _black_is_no_mistake():
            return torch.stack([self._metric.predict(one, other, **rates)[0] for one, other in pairs]).cpu()

    def record(self) -> dict[str, Any]:
        """Return what a table of results must say of this metric."""
        return {"cvvdp": version("cvvdp"), "frames_per_second": FRAMES_PER_SECOND, "ppd": PIXELS_PER_DEGREE}


@contextmanager
def _black_is_no_mistake() -> Iterator[None]:
    """Keep the package from warning of each film that is black for the most part, as if its unit were wrong."""

    def heard(record: logging.LogRecord) -> bool:
        return "absolute photometric units" not in record.getMessage()

    root = logging.getLogger()
    root.addFilter(heard)
    try:
        yield
    finally:
        root.removeFilter(heard)


def available_video_quality(device: torch.device | str = "cpu") -> tuple[VideoQuality | None, str]:
    """Return ColorVideoVDP where its package is installed, and what a report must say either way."""
    if importlib.util.find_spec("pycvvdp") is None:
        return None, "no ColorVideoVDP: the package cvvdp is not installed"
    how = f"standard_4k, {FRAMES_PER_SECOND:g} frames per second, {PIXELS_PER_DEGREE:.2f} pixels per degree"
    return VideoQuality(device), f"ColorVideoVDP {version('cvvdp')}: {how}"
