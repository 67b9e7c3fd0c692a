"""The PSF image: nothing overlaps or is cut off, whatever the stack; and the facts that it states."""

import warnings
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image

from psf_library.designs.diffusercam import diffusercam
from psf_library.designs.pinhole import pinhole
from simulator.optics.error_budget.budget import proven_psf_stack, quick_errors, read_budget, with_budget
from simulator.optics.mask import Mask
from simulator.optics.materials import PHLATCAM_RESIST
from simulator.optics.psf import PsfConfig
from simulator.optics.spectra import spectral_response
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.plots.psf import plot_psf_stack, psf_figure, shown_depths
from simulator.plots.psf_facts import budget_facts, psf_depth_limit_m, psf_facts
from simulator.text import share
from simulator.types import CameraGeometry, SpectralResponse, View

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")


def _computed(mask, d, pitch, depths, response=GREEN, lines=1):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # these small masks are coarsely sampled; that is not the subject
        config = PsfConfig(depths, wavelengths_per_channel=lines, accept_error=10.0)
        camera, view = CameraGeometry(d, pitch, response), View((8, 8), pitch, d, depths[0], depths[-1])
        stack = proven_psf_stack(mask, camera, config)
        return with_budget(stack, quick_errors(mask, camera, config, view, stack=stack)), mask


def _staircase(samples):
    height = np.random.default_rng(0).integers(0, 6, (samples, samples)) * np.float32(0.2e-6)
    return Mask(height, np.ones_like(height), 2e-6, PHLATCAM_RESIST, "staircase", "phlatcam-like")


def _cases():
    rng = np.random.default_rng(0)
    measured = {
        "kind": "measured",
        "throughput_m2": 2e-5,
        "background": "border",
        "same_psf_for_all_channels": True,
        "images": [{"file": "psf.tif"}],
    }
    grey = np.repeat(rng.random((1, 1, 60, 81)) ** 6, 3, axis=1)
    return {
        "fine staircase, colour": lambda: (
            _computed(_staircase(60), 1e-3, 9.6e-6, (0.036, 0.05, 0.2), spectral_response(), 3)[0],
            _staircase(450),
        ),
        "diffuser, infinity": lambda: _computed(diffusercam(width_mm=0.4), 2e-3, 9.6e-6, (0.05, 0.3, np.inf)),
        "pinhole, two depths": lambda: _computed(pinhole(pixel_um=4), 1.9e-3, 19.2e-6, (0.1, np.inf)),
        "pinhole, one depth": lambda: _computed(pinhole(pixel_um=4), 1.9e-3, 4.8e-6, (np.inf,)),
        "measured": lambda: (PsfStack(grey, np.array([0.3]), 1e-5, ("R", "G", "B"), "f", measured), None),
        "one pixel": lambda: (PsfStack(np.ones((1, 1, 1, 1)), np.array([1.0]), 1e-5, ("Y",), "f"), None),
    }


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if "staircase" in name else ()) for name in _cases()]
)
@pytest.mark.slow
def test_nothing_overlaps_or_leaves_the_image(name, written):
    stack, mask = _cases()[name]()
    figure = psf_figure(stack, mask, (16, 16), (40, 60))
    figure.canvas.draw()
    assert len(written) > 20
    for text, box in written.items():
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
    for (a, one), (b, other) in combinations(written.items(), 2):
        wide = min(one.x1, other.x1) - max(one.x0, other.x0)
        high = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert min(wide, high) <= 1, f"{a} and {b} overlap"  # boxes include a pixel of air


def test_the_autocorrelations_image_covers_no_curve():
    """A PSF of one broad blot, whose autocorrelation is high at all shifts that are drawn."""
    y, x = np.mgrid[-20:21, -20:21]
    blot = np.exp(-np.hypot(x, y) / 30)[None, None]
    figure = psf_figure(PsfStack(blot, np.array([1.0]), 1e-5, ("Y",), "f"), None)
    figure.canvas.draw()
    (axes,) = (axes for part in figure.subfigs for axes in part.axes if axes.get_title(loc="left") == "Autocorrelation")
    (inset,) = axes.child_axes
    (line,) = axes.lines
    points = axes.transData.transform(line.get_xydata())
    assert line.get_ydata()[1] > 0.9
    assert points[:, 1].max() < inset.get_tightbbox().y0


def test_the_image_is_written_whole(tmp_path):
    values = np.random.default_rng(0).random((3, 3, 20, 21))
    stack = PsfStack(values, np.array([0.1, 0.2, np.inf]), 1e-5, ("R", "G", "B"), "f")
    path = plot_psf_stack(stack, None, tmp_path / "psf.png")
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.size == (2400, 1350)
        assert len(image.resize((60, 34)).convert("RGB").getcolors(maxcolors=10**4) or []) > 100
    assert [entry.name for entry in tmp_path.iterdir()] == ["psf.png"]


def _panels(figure, title):
    return [axes for axes in figure.findobj(Axes) if axes.get_title("left").startswith(title)]


def test_the_psfs_are_drawn_upright_in_colour_on_one_scale():
    """A red, a green and a blue dot at known places; the second depth a quarter as bright, so half after the root."""
    values = np.zeros((2, 3, 21, 21))
    places = [(4, 6), (10, 15), (17, 9)]
    for channel, (row, column) in enumerate(places):
        values[:, channel, row, column] = [4.0, 1.0]
    figure = psf_figure(PsfStack(values, np.array([0.1, 0.2]), 1e-5, ("R", "G", "B"), "f"), None)
    panels = _panels(figure, "PSF at")
    near, far = (axes.get_images()[0].get_array() for axes in panels)
    assert near.shape == (21, 21, 3)
    for channel, place in enumerate(places):
        expected = np.zeros(3)
        expected[channel] = 1
        np.testing.assert_allclose(near[place], expected)
        np.testing.assert_allclose(far[place], expected / 2)
    left, right, bottom, top = panels[0].get_images()[0].get_extent()
    # The origin is the middle of sample 10; rows go down; the window is labelled in mm.
    np.testing.assert_allclose([left, right, bottom, top], [-0.105, 0.105, 0.105, -0.105])


@pytest.mark.parametrize(
    ("depths", "shown"),
    [([1.0], [0]), ([1.0, np.inf], [0, 1]), ([1.0, 2.0, np.inf], [0, 1, 2]), ([0.1, 0.11, 0.12, 0.2, 10.0], [0, 3, 4])],
)
def test_the_middle_depth_is_the_middle_of_disparity(depths, shown):
    assert shown_depths(np.array(depths)) == shown


def test_facts_of_a_computed_stack():
    stack, mask = _computed(pinhole(diameter_um=200, pixel_um=4), 2e-3, 10e-6, (0.05, 0.1), spectral_response(), 2)
    facts = dict(psf_facts(stack, mask, (10, 10), (20, 20)))
    assert facts["mask"] == "pinhole, 204 µm × 204 µm"
    assert facts["transmitted area"] == f"{mask.transmitted_area_m2 * 1e6:.3g} mm²"
    assert facts["mask to sensor"] == "2 mm"
    assert facts["pixel pitch"] == "10 µm"
    assert facts["depths"] == "2, 5 cm to 10 cm"
    assert facts["z_max"].startswith("2.04 cm:")  # 204 um x 2 mm / (2 x 10 um)
    assert facts["model"] == "scaled_distance"
    assert facts["wavelengths G"].split() == [f"{w * 1e9:.0f}" for c, w, _ in stack.provenance["lines"] if c == "G"] + [
        "nm"
    ]
    assert "nominal" in facts["response"]
    assert facts["sampling error"] == f"at most {share(2 * stack.provenance['sampling']['error'])}"
    rows = read_budget(stack)
    worst = {row.name: max(other.value for other in rows if other.name == row.name) for row in rows}
    assert budget_facts(stack) == [("errors", ", ".join(f"{name} {share(value)}" for name, value in worst.items()))]
    assert len(worst) == 5
    shares = stack.energy_m2() / mask.transmitted_area_m2
    assert facts["light on PSF grid"].startswith(share(shares.min()))
    assert facts["light off sensor"] != "0 %"
    assert dict(psf_facts(stack))["z_max"] == facts["z_max"]  # the stack's own record serves where there is no mask
    unproven = replace(stack, provenance=stack.provenance | {"sampling": UNPROVEN})
    assert dict(psf_facts(unproven))["sampling"] == "unproven"


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ({"R": [450, 600], "G": [450, 600], "B": [450, 600]}, {"wavelengths": "450 600 nm"}),
        (
            {"R": [550, 600], "G": [450, 550], "B": [450, 550]},
            {"wavelengths R": "550 600 nm", "wavelengths G B": "450 550 nm"},
        ),
        ({"Y": [400, 450, 500, 550, 600, 650]}, {"wavelengths": "400 450 … 600 650 nm"}),
    ],
)
def test_wavelengths_are_listed_once(lines, told):
    record = [[channel, nm * 1e-9, 0.5] for channel, all_nm in lines.items() for nm in all_nm]
    values = np.ones((1, len(lines), 1, 1))
    stack = PsfStack(values, np.array([1.0]), 1e-5, tuple(lines), "f", {"lines": record})
    assert [fact for fact in psf_facts(stack) if "wavelengths" in fact[0]] == list(told.items())


def test_the_depth_limit_follows_the_open_part_of_the_mask():
    """An opaque rim does not count: it sends no light."""
    amplitude = np.pad(np.ones((30, 50)), 200)
    mask = Mask(np.zeros_like(amplitude), amplitude, 2e-6)
    stack = PsfStack(np.ones((1, 1, 5, 5)), np.array([1.0]), 1e-5, ("Y",), "f", {"mask_to_sensor_m": 2e-3})
    assert psf_depth_limit_m(stack, mask) == pytest.approx(50 * 2e-6 * 2e-3 / 2e-5)
    assert psf_depth_limit_m(stack) is None
