"""ColorVideoVDP: the package itself where it is installed (group bench), and what is told without it."""

from __future__ import annotations

import pytest
import torch

from learning.perceptual import PIXELS_PER_DEGREE
from learning.video_quality import VideoQuality, available_video_quality


def test_without_the_package_there_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learning.video_quality.importlib.util.find_spec", lambda name: None)
    metric, words = available_video_quality()
    assert metric is None
    assert words == "no ColorVideoVDP: the package cvvdp is not installed"


@pytest.mark.slow  # importing the package takes 8 s
def test_noise_that_changes_is_seen_less_than_the_same_at_rest(caplog: pytest.LogCaptureFixture) -> None:
    """The eye averages it; a PSNR does not tell them apart. Equal films have the scale's end, 10."""
    pytest.importorskip("pycvvdp", reason="needs the package cvvdp: group bench")
    metric = VideoQuality()
    generator = torch.Generator().manual_seed(0)
    truth = torch.full((1, 10, 3, 64, 64), 0.5)
    error = 0.1 * torch.randn(10, 1, 64, 64, generator=generator)
    still, changing = truth + error[:1], truth + error
    assert metric(truth, truth).tolist() == [10.0]
    at_rest, changed = metric(torch.cat([still, changing]), truth.expand(2, -1, -1, -1, -1)).tolist()
    assert 0 < at_rest < changed < 10
    assert metric.record()["frames_per_second"] == 5
    assert metric(0 * truth, 0 * truth).tolist() == [10.0]
    assert not caplog.records  # black is no film in the wrong unit
    # As the package's own command would be called for such a display
    import pycvvdp
    from pycvvdp.display_model import vvdp_display_geometry

    geometry = vvdp_display_geometry([64, 64], ppd=PIXELS_PER_DEGREE)
    own = pycvvdp.cvvdp(display_name="standard_4k", display_geometry=geometry, device=torch.device("cpu"), quiet=True)
    codes = [(255 * each[0]).round().clamp(0, 255).byte().permute(2, 3, 1, 0).numpy() for each in (changing, truth)]
    told, _ = own.predict(*codes, dim_order="HWCF", frames_per_second=5)
    # 8-bit codes in place of float32
    assert changed == pytest.approx(float(told), abs=0.01)
