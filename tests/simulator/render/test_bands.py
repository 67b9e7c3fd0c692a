"""Spectral rendering into bands, against integrals over published curves, and against rendering in RGB."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import colour
import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.config.schema import RenderConfig
from simulator.errors import InputError
from simulator.render import Renderer, choose_backend
from simulator.render.bands import split_film

Pictures = Mapping[str, NDArray[Any]]
EDGES_NM = (400.0, 430.0, 480.0, 550.0, 620.0, 700.0)  # as in worker.py
PAINT = np.array([0.8, 0.3, 0.1])
# 192 pixels x 64 paths of four wavelengths each; the widest spread of a path over a band is about 3 of its value.
NOISE = 0.01


# The LLVM one compiles a dozen kernels of its own.
@pytest.fixture(scope="module", params=["scalar_spectral", pytest.param("llvm_ad_spectral", marks=pytest.mark.slow)])
def spectral(request: pytest.FixtureRequest, rendered: Callable[..., Pictures]) -> Pictures:
    if request.param.startswith("llvm"):
        request.getfixturevalue("needs_llvm")
    return rendered("simulator/render/worker.py", "bands", request.param)


@pytest.fixture(scope="module")
def in_rgb(rendered: Callable[..., Pictures]) -> Pictures:
    return rendered("simulator/render/worker.py", "bands", "scalar_rgb")


def d65(wavelengths_nm: NDArray[Any]) -> NDArray[Any]:
    """Light of RGB (1, 1, 1): CIE D65 of luminance 1, as a flat spectrum of 1 has; colour-science's table."""
    table = colour.SDS_ILLUMINANTS["D65"]
    fine = np.arange(360.0, 831.0)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    y = np.interp(fine, observer.wavelengths, observer.values[:, 1])
    light = np.interp(fine, table.wavelengths, table.values)
    return np.interp(wavelengths_nm, table.wavelengths, table.values) * y.sum() / (light @ y)


def test_bands_of_white_light_are_means_of_d65(spectral: Pictures) -> None:
    expected = [d65(np.linspace(first, last, 2001)).mean() for first, last in pairwise(EDGES_NM)]
    assert max(expected) > 1.1
    assert min(expected) < 0.85
    np.testing.assert_allclose(spectral["light.bands"].mean(axis=(0, 1)), expected, rtol=NOISE)


def test_a_grey_wall_reflects_the_same_share_of_all_bands(spectral: Pictures) -> None:
    light, wall = (spectral[f"{name}.bands"].mean(axis=(0, 1)) for name in ("light", "grey"))
    np.testing.assert_allclose(wall / light, 0.5, rtol=NOISE)


@pytest.mark.parametrize(
    ("name", "expected"), [("light", (1, 1, 1)), ("tinted", (0.2, 1, 3)), ("grey", (0.5, 0.5, 0.5)), ("paint", PAINT)]
)
def test_colours_survive_the_way_through_spectra(
    spectral: Pictures, in_rgb: Pictures, name: str, expected: tuple[float, ...]
) -> None:
    found, plain = (pictures[f"{name}.rgb"].mean(axis=(0, 1)) for pictures in (spectral, in_rgb))
    np.testing.assert_allclose(found, plain, rtol=NOISE)
    np.testing.assert_allclose(found, expected, rtol=NOISE)


@pytest.mark.parametrize("name", ["light", "tinted", "paint"])
def test_fine_bands_have_the_colour_of_the_picture(spectral: Pictures, name: str) -> None:
    """47 bands of 10 nm under the colour matching functions of colour-science are the colour that the film measured."""
    bands = spectral[f"{name}.fine.bands"].mean(axis=(0, 1))
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    fine = np.arange(360.0, 830.0) + 0.5
    curves = np.stack([np.interp(fine, observer.wavelengths, curve) for curve in observer.values.T])
    xyz = curves.reshape(3, 47, 10).sum(axis=2) @ bands / curves[1].sum()
    rgb = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ xyz
    # Spectra bend within 10 nm, D65 most: half a percent of white.
    found = spectral[f"{name}.fine.rgb"].mean(axis=(0, 1))
    np.testing.assert_allclose(rgb, found, atol=0.015 * found.max())


def test_updates_within_a_clip_are_what_a_still_shows(spectral: Pictures) -> None:
    first, second, third = spectral["change.rgb"].mean(axis=(1, 2))
    np.testing.assert_allclose(first, 0.5, rtol=NOISE)
    np.testing.assert_allclose(third, 0.5, rtol=NOISE)
    np.testing.assert_allclose(second, spectral["alone.rgb"].mean(axis=(0, 1, 2)), rtol=NOISE)


def test_coloured_light_on_coloured_paint_is_more_than_rgb_knows(spectral: Pictures, in_rgb: Pictures) -> None:
    """RGB multiplies channel by channel; spectra overlap, so that blue light on orange paint is less dull."""
    second = spectral["change.rgb"].mean(axis=(1, 2))[1]
    plain = in_rgb["change.rgb"].mean(axis=(1, 2))[1]
    np.testing.assert_allclose(plain, PAINT * (0.2, 1, 3), rtol=NOISE)
    assert second[0] > 1.5 * plain[0]


def test_albedo_and_motion_are_known_there_too(spectral: Pictures, in_rgb: Pictures) -> None:
    seen = in_rgb["ball.albedo"].any(axis=-1)
    assert seen.sum() > 30
    # The fit of spectra to colours is exact to 0.001.
    np.testing.assert_allclose(spectral["ball.albedo"], in_rgb["ball.albedo"], atol=2e-3)
    assert set(np.unique(spectral["moves.shape_id"])) == {0, 1, 2, 3}
    assert np.abs(spectral["moves.motion"][0]).max() > 0.25
    assert spectral["moves.motion_valid"][0].any()
    assert spectral["moves.bands"].shape == (3, 12, 16, 5)


def test_colours_outside_of_srgb_are_clipped_at_zero() -> None:
    image = np.zeros((1, 1, 5), np.float32)
    image[..., 3] = 1.0  # Y alone: a green beyond sRGB's
    rgb, bands = split_film(image)
    assert rgb[0, 0, 1] > 0
    np.testing.assert_array_equal(rgb[0, 0, (0, 2)], 0)
    assert bands.shape == (1, 1, 2)


def test_what_bands_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"^render\.bands: "):
        Renderer("scalar_rgb", bands_nm=EDGES_NM)
    for edges in ((500.0,), (500.0, 500.5), (300.0, 500.0)):
        with pytest.raises(InputError, match=r"^render\.bands: "):
            Renderer("scalar_spectral", bands_nm=edges)
    with pytest.raises(InputError, match=r"^render\.outputs: "):
        Renderer("scalar_spectral", ("hidden",), bands_nm=EDGES_NM)


def test_bands_are_given_by_range_or_edges() -> None:
    def edges(**keys: Any) -> tuple[float, ...]:
        bands = RenderConfig.model_validate({"bands": keys}).bands
        assert bands is not None
        return bands.edges

    assert edges(from_nm=400, to_nm=700, count=3) == (400, 500, 600, 700)
    assert edges(edges_nm=(400, 450, 500.5)) == (400, 450, 500.5)
    for keys in (
        {"from_nm": 400, "to_nm": 700},
        {"edges_nm": (400, 500), "count": 3},
        {"from_nm": 700, "to_nm": 400, "count": 2},
        {"edges_nm": (300, 400)},
    ):
        with pytest.raises(ValueError, match="bands"):
            edges(**keys)


@pytest.mark.usefixtures("needs_llvm")
def test_the_backend_for_bands_is_spectral() -> None:
    assert choose_backend("scalar", spectral=True).variant == "scalar_spectral"
    assert choose_backend("auto", spectral=True).variant == "llvm_ad_spectral"
