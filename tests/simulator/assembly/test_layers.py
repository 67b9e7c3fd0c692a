"""Layers of a configuration: their order, the distance in air by hand, and what the fingerprint sees of them."""

import pytest

from simulator.assembly import Assembly
from simulator.config import config_from_dict, dump, load_config
from simulator.errors import InputError
from simulator.optics.materials import AIR, N_BK7

N_BK7_550 = 1.518523  # SCHOTT's formula at 550 nm, worked out by hand


def _geometry(trial, **camera):
    return Assembly(load_config(trial.write(camera=camera))).geometry


def test_air_alone_has_no_layers(trial):
    geometry = _geometry(trial)
    assert (geometry.gap, geometry.window, geometry.mask_to_sensor_m) == ((), (), 1.9e-3)


def test_a_cover_glass_shortens_the_distance_in_air(trial):
    """1.2 mm of air and 0.7 mm of glass: paraxial rays arrive as after 1.2 + 0.7 / n mm of air."""
    gap = [{"mm": 1.2, "n": "air"}, {"mm": 0.7, "material": "n-bk7"}, {"mm": 0.1, "n": 1.41}]
    config = load_config(trial.write(camera={"mask_to_sensor_mm": None, "gap": gap}))
    geometry = Assembly(config).geometry
    assert [layer.thickness_m for layer in geometry.gap] == pytest.approx([1.2e-3, 0.7e-3, 0.1e-3])
    assert [layer.material.name for layer in geometry.gap] == ["air", "n-bk7", "n = 1.41"]
    assert geometry.gap[2].material.index(450e-9) == geometry.gap[2].material.index(700e-9) == 1.41
    expected = 1.2e-3 + 0.7e-3 / N_BK7_550 + 0.1e-3 / 1.41
    assert geometry.mask_to_sensor_m == pytest.approx(expected, rel=1e-6)
    assert Assembly(config).view.distance_m == geometry.mask_to_sensor_m
    assert config.camera.thickness_mm == pytest.approx(2.0)


def test_a_substrate_on_the_sensors_side_comes_first(trial):
    plate = {"mm": 0.5, "material": "n-bk7", "side": "sensor"}
    geometry = _geometry(trial, substrate=plate)
    assert [(layer.thickness_m, layer.material) for layer in geometry.gap] == [(0.5e-3, N_BK7), (1.9e-3, AIR)]
    assert geometry.mask_to_sensor_m == pytest.approx(1.9e-3 + 0.5e-3 / N_BK7_550, rel=1e-6)
    assert geometry.window == ()
    both = _geometry(trial, substrate=plate, mask_to_sensor_mm=None, gap=[{"mm": 1.9, "n": "air"}])
    assert both.gap == geometry.gap


def test_a_substrate_on_the_scenes_side_is_a_window(trial):
    geometry = _geometry(trial, substrate={"mm": 0.5, "material": "n-bk7", "side": "scene"})
    assert (geometry.gap, geometry.mask_to_sensor_m) == ((), 1.9e-3)
    assert [(layer.thickness_m, layer.material) for layer in geometry.window] == [(0.5e-3, N_BK7)]


def test_a_material_file_lies_beside_the_yaml_file_and_is_an_input(trial):
    (trial.folder / "glue.csv").write_text("wavelength_nm,n\n300,1.6\n900,1.5\n")
    gap = [{"mm": 1.8, "n": "air"}, {"mm": 0.1, "material": "glue.csv"}]
    plate = {"mm": 0.5, "material": "glue.csv", "side": "scene"}
    config = load_config(trial.write(camera={"mask_to_sensor_mm": None, "gap": gap, "substrate": plate}))
    geometry = Assembly(config).geometry
    assert geometry.gap[1].material.index(600e-9) == pytest.approx(1.55)
    source = Assembly(config, "none").source
    assert [path.name for path in Assembly(config).having(source=source).input_files].count("glue.csv") == 1
    (trial.folder / "glue.csv").write_text("wavelength_nm,n\n300,1.6\n")
    with pytest.raises(InputError, match=r"trial\.yaml:\d+:\d+: camera\.gap\[1\]\.material: .*glue\.csv: "):
        load_config(trial.path)
    # A data set that somebody else made is read without its files.
    config_from_dict(dump(config), trial.folder, check_plugins=False)


def test_a_layer_that_is_unknown_at_a_channels_wavelength_is_named(trial):
    gap = [{"mm": 1.8, "n": "air"}, {"mm": 0.1, "material": "noa61"}]
    config = load_config(trial.write(camera={"mask_to_sensor_mm": None, "gap": gap}, psf={"depths_cm": [5]}))
    with pytest.raises(InputError, match=r"'B' of Nikon 5100 \(NPL\) under D65.* 'noa61'"):
        _ = Assembly(config).psf_stack


def test_a_designs_material_file_lies_beside_the_yaml_file(trial):
    """The design's parameter ``material`` is text; a file's content decides the cache and the fingerprint."""
    trial.plugins.write_text(
        trial.plugins.read_text()
        + "\n\ndef slab(*, material: str = 'fused-silica') -> Mask:\n"
        + "    from simulator.optics.materials import load_material\n"
        + "    return Mask(np.zeros((9, 9)), np.ones((9, 9)), 2e-6, load_material(material))\n"
    )
    seen = []
    for n in (1.5, 1.7):
        (trial.folder / "glue.csv").write_text(f"wavelength_um,n\n0.3,{n}\n0.9,{n}\n")
        config = load_config(trial.write(camera={"mask": {"design": "./plugins.py:slab", "material": "glue.csv"}}))
        for _ in range(2):  # designed, then from the cache
            mask = Assembly(config).mask
            assert mask is not None
            seen.append((mask.material.name, mask.material.index(532e-9), mask.digest()))
    assert seen[0] == seen[1] != seen[2] == seen[3]
    assert [entry[:2] for entry in seen[::2]] == [("glue.csv", 1.5), ("glue.csv", 1.7)]
    source = Assembly(config, "none").source
    assert "glue.csv" in [path.name for path in Assembly(config).having(source=source).input_files]
