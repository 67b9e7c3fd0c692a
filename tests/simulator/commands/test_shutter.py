"""``shutter`` as users meet it."""

import pytest
from PIL import Image

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_says_what_the_shutter_means(flatlight, trial) -> None:
    shutter = {"type": "rolling", "exposure_ms": 1, "line_time_us": 11}
    code, out, err = flatlight("shutter", trial.write(camera={"shutter": shutter}))
    assert code == 0, err
    # 383 steps of 11 us and an exposure; a row of the picture is open for 1.077 ms, the next opens 88 us later.
    assert "5.213 ms until the last row closes" in out
    assert "frames told apart  4: " in out
    assert "light from the middle  " in out
    assert err == ""


def test_draws_the_figures(flatlight, trial, tmp_path) -> None:
    code, out, err = flatlight("shutter", trial.write(), "--figures", tmp_path / "a" / "b")
    assert code == 0, err
    drawn = sorted((tmp_path / "a" / "b").iterdir())
    assert out.count("look at ") == len(drawn) == 4
    for path in drawn:
        with Image.open(path) as picture:
            picture.load()
            assert min(picture.size) > 600


@pytest.mark.slow
def test_one_depth_is_no_figure_of_two(flatlight, trial, tmp_path) -> None:
    psf = {"depths_cm": [20], "wavelengths_per_channel": 1, "accept_error": 1}
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "near_cm": 10, "far_cm": 30}
    code, _, err = flatlight("shutter", trial.write(psf=psf, scene=scene), "--figures", tmp_path)
    assert code == 0, err
    assert "points_at_two_depths.png" not in {file.name for file in tmp_path.glob("*.png")}


def test_mistakes_are_one_line_before_anything_is_drawn(one_error, flatlight, trial) -> None:
    result = flatlight("shutter", trial.write(), "--figures", trial.plugins / "x")
    one_error(result, "--figures", "plugins.py")
    assert result[1] == ""
    path = trial.write(camera={"shutter": {"type": "windows", "file": "none.csv"}})
    one_error(flatlight("shutter", path), f"{path}:", "camera.shutter.file", "none.csv")
