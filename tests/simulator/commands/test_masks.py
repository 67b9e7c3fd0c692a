"""``export-mask`` as users meet it: files that read back as the mask, nothing overwritten, nothing half done."""

import re

import numpy as np
import pytest
import yaml

from psf_library import load_mask

SMALL = {"design": "phlatcam", "width_mm": 0.06, "iterations": 2}


@pytest.fixture
def phase(trial):
    """A configuration with a small PhlatCam."""
    return trial.write(camera={"mask": SMALL})


def _designs(out: str) -> list[dict]:
    """The masks of the lines that the command prints for a configuration."""
    return [yaml.safe_load(line)["mask"] for line in re.findall(r"^  (mask: .*)$", out, re.MULTILINE)]


def test_the_printed_lines_make_the_same_mask(flatlight, phase, tmp_path) -> None:
    """Half a code of 16 bits over 1 um is 8 pm."""
    code, out, err = flatlight("export-mask", phase, "--stl", tmp_path / "m.stl", "--tiff", tmp_path / "m.tif")
    assert code == 0, err
    original, designs = load_mask(**SMALL), _designs(out)
    assert len(designs) == 2
    for params in designs:
        again = load_mask(**params)
        assert (again.pitch_m, again.material, again.profile) == (
            pytest.approx(original.pitch_m),
            original.material,
            original.profile,
        )
        np.testing.assert_allclose(again.height_m, original.height_m - original.height_m.min(), rtol=0, atol=8.1e-12)


def test_who_writes_a_large_body_is_told_of_the_height_map(flatlight, phase, tmp_path, monkeypatch) -> None:
    """30 x 30 heights of 16 bits; not said to those who write one."""
    assert "--tiff" not in flatlight("export-mask", phase, "--stl", tmp_path / "small.stl")[1]
    monkeypatch.setattr("simulator.commands.masks.LARGE_BYTES", 1000)
    assert "--tiff" in flatlight("export-mask", phase, "--stl", tmp_path / "a.stl")[1]
    both = flatlight("export-mask", phase, "--stl", tmp_path / "b.stl", "--tiff", tmp_path / "b.tif")
    assert "--tiff" not in both[1]


def test_a_material_of_ones_own_keeps_its_file(flatlight, trial, tmp_path) -> None:
    (trial.folder / "resist.csv").write_text("wavelength_nm,n\n350,1.6\n500,1.58\n900,1.55\n")
    path = trial.write(camera={"mask": SMALL | {"material": "./resist.csv"}})
    code, out, err = flatlight("export-mask", path, "--stl", tmp_path / "m.stl")
    assert code == 0, err
    (params,) = _designs(out)
    assert params["material"] == "./resist.csv"
    assert load_mask(base_dir=trial.folder, **params).material.index(500e-9) == pytest.approx(1.58)


def test_layers_and_crop(flatlight, phase, tmp_path) -> None:
    code, out, _ = flatlight("export-mask", phase, "--layers", tmp_path / "steps", "--crop-mm", 0.04)
    assert code == 0
    names = sorted(path.name for path in (tmp_path / "steps").iterdir())
    assert names == [*(f"layer_00{n}.png" for n in (1, 2, 3, 4, 5)), "layers.json"]
    assert "layer_001.png, ..., layer_005.png" in out
    from PIL import Image

    with Image.open(tmp_path / "steps" / "layer_001.png") as picture:
        assert picture.size == (20, 20)


def test_an_amplitude_mask_has_no_body(flatlight, one_error, trial, tmp_path) -> None:
    path = trial.write(camera={"mask": {"design": "pinhole"}})
    refused = flatlight("export-mask", path, "--stl", tmp_path / "m.stl", "--layers", tmp_path / "m")
    one_error(refused, "'pinhole'")
    assert not list(tmp_path.glob("m*"))  # the layers that could have been written were not begun
    assert flatlight("export-mask", path, "--layers", tmp_path / "m")[0] == 0
    assert (tmp_path / "m" / "aperture.png").is_file()


def test_nothing_is_overwritten_unasked(flatlight, one_error, phase, tmp_path) -> None:
    arguments = ("export-mask", phase, "--tiff", tmp_path / "m.tif", "--layers", tmp_path / "m")
    assert flatlight(*arguments)[0] == 0
    one_error(flatlight(*arguments), "--tiff", "m.tif", "--force")
    one_error(flatlight(*arguments[:2], *arguments[4:]), "--layers", "--force")
    assert flatlight(*arguments, "--force")[0] == 0
    (tmp_path / "m" / "thesis.txt").write_text("years of work")
    one_error(flatlight(*arguments, "--force"), f"{tmp_path / 'm'}")
    assert (tmp_path / "m" / "thesis.txt").read_text() == "years of work"
    folder = tmp_path / "m.stl"
    folder.mkdir()
    one_error(flatlight("export-mask", phase, "--stl", folder, "--force"), "m.stl")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--stl"),
        (("--tiff", "a/m.tif"), "--tiff"),
        (("--layers", "m"), "step_um"),
        (("--stl", "m.x"), "--stl: "),
        (("--tiff", "m.stl"), "--tiff: "),
        (("--stl", "m.stl", "--layers", "m.stl"), "--layers: "),
        (("--layers", "phase.yaml/m"), "phase.yaml"),
        (("--stl", "m.stl", "--base-um", "inf"), "--base-um: "),
        (("--tiff", "m.tif", "--crop-mm", "inf"), "--crop-mm: "),
        (("--tiff", "m.tif", "--crop-mm", "9"), "--crop-mm: "),
        (("--tiff", "m.tif", "--crop-mm", "0.06001"), None),
    ],
)
def test_impossible_outputs(flatlight, one_error, trial, tmp_path, monkeypatch, arguments, words) -> None:
    path = trial.write(camera={"mask": {"design": "diffusercam", "width_mm": 0.06}}).rename(tmp_path / "phase.yaml")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    result = flatlight("export-mask", path, *arguments)
    if words is None:
        assert result[0] == 0
    else:
        one_error(result, words)
        assert sorted(tmp_path.iterdir()) == before


def test_masks(flatlight) -> None:
    code, out, _ = flatlight("masks")
    assert code == 0
    assert out.startswith("camera.mask.design:")
    for words in ("  phlatcam: ", "  pinhole: ", "  diffusercam: ", "      width_mm: 7.01"):
        assert words in out
    assert "number over 0.05 to 20; side of the square mask" in out


def test_materials(flatlight) -> None:
    code, out, _ = flatlight("materials")
    assert code == 0
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "1.51947" in lines["n-bk7"]  # SCHOTT's catalogue at 532 nm
    assert "300-2500" in lines["n-bk7"]
    assert "nominal" in lines["phlatcam-resist"]
    assert ".csv" in out
