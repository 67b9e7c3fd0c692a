"""Loading: precedence and overrides, what Config remembers, the dump and its way back, the shipped file."""

import json
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from simulator.camera.noise import GaussianNoise, PhysicalNoise
from simulator.camera.shutter import GlobalShutter
from simulator.config import ConfigError, config_from_dict, default_config_text, dump, json_schema, load_config
from simulator.config.psf import ComputedPsf
from simulator.errors import InputError

Write = Callable[..., Path]


def test_defaults_then_file_then_overrides(write: Write) -> None:
    path = write()
    config = load_config(path)
    assert config.camera.illuminant == "D65"  # default
    assert config.camera.shutter == GlobalShutter(0.005)  # file
    assert config.camera.mask is not None
    assert config.camera.mask.params == {"width_mm": 2.0, "charge": 1, "kind": "a"}  # the file's, the plugin's defaults
    config = load_config(
        path,
        [
            "camera.shutter.exposure_ms=1e1",
            "camera.illuminant=A",
            "scene.size=[64, 64]",
            "forward.vignetting=false",
            "camera.noise={type: physical}",
            "camera.mask.charge=4",
            "seed=4",
            "seed=5",
        ],
    )
    assert config.camera.shutter == GlobalShutter(0.01)
    assert config.camera.illuminant == "A"
    assert config.scene.size == (64, 64)
    assert config.forward.vignetting is False
    assert config.camera.noise == PhysicalNoise()
    assert config.camera.mask is not None
    assert config.camera.mask.params["charge"] == 4
    assert config.seed == 5


def test_null_takes_a_key_away(write: Write) -> None:
    config = load_config(write(), ["camera.noise.psnr_db=null", "camera.noise.std=0.02", "psf.spacing=null"])
    assert config.camera.noise == GaussianNoise(std=0.02)
    assert isinstance(config.psf, ComputedPsf)
    assert config.psf.spacing == "disparity"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.mask_to_sensor_mm=532", ["camera.mask_to_sensor_mm:"]),
        ("camera.sensr.binning=2", ["camera.sensr:", "did you mean 'sensor'?"]),
        ("camera.sensor.bining=2", ["camera.sensor.bining:", "did you mean 'binning'?"]),
        ("camera.mask.chrge=2", ["camera.mask.chrge:", "did you mean 'charge'?"]),
        ("camera.mask.charge=x", ["camera.mask.charge:"]),
        ("scene.size=[33, 32]", ["scene.size[0]:", "half a pixel"]),
        ("camera.mask={design: no}", ["camera.mask.design:"]),
        ("camera.sensor=null", ["camera.sensor:"]),
        ("dataset.train=010", ["leading zero"]),
        ("scene.size=[1, 2", ["not valid YAML"]),
        ("scene.size.0=3", ["scene.size is [32, 32], not a mapping; set it as a whole"]),
        ("seed", ["expected key=value"]),
        ("=3", ["expected key=value"]),
        ("camera..mask=3", ["expected key=value"]),
        ("seed=", ["the value is missing"]),
    ],
)
def test_refused_overrides(write: Write, override: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_config(write(), [override])
    message = str(caught.value)
    assert message.startswith(f"--set {override}: ")
    assert "\n" not in message
    assert all(word in message for word in words), message


def test_a_fault_of_the_file_is_not_put_on_an_override(write: Write) -> None:
    path = write("binning: 4", "binning: 0")
    with pytest.raises(InputError) as caught:
        load_config(path, ["camera.sensor.shape=[32, 32]", "seed=-1"])
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{path}:6:38: camera.sensor.binning: got 0")
    assert second.startswith("--set seed=-1: seed: got -1")


def test_an_override_may_mend_the_file(write: Write) -> None:
    assert load_config(write("binning: 4", "binning: 0"), ["camera.sensor.binning=2"]).camera.sensor.binning == 2


@pytest.mark.parametrize(("text", "what"), [("[1, 2]", "[1, 2]"), ("word", "'word'"), ("---", "nothing")])
def test_a_file_that_is_no_mapping(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "f.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert str(caught.value) == f"{path}:1:1: expected a mapping of keys to values, got {what}"


def test_relative_paths_start_at_the_file(write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = write()
    monkeypatch.chdir(tmp_path)
    config = load_config(path.name)
    assert config.base_dir == tmp_path.resolve()
    assert config.scene.params["path"] == "room.ply"  # as written
    assert config.resolve_path(config.dataset.output) == tmp_path.resolve() / "out"
    assert config.resolve_path("/far/away") == Path("/far/away")
    assert "base_dir" not in json.dumps(dump(config))


def test_config_is_frozen_and_survives_pickling(write: Write) -> None:
    config = load_config(write())
    with pytest.raises(ValidationError, match="frozen"):
        config.seed = 4  # pyright: ignore[reportAttributeAccessIssue]
    copy = pickle.loads(pickle.dumps(config))
    assert copy == config
    assert copy.base_dir == config.base_dir


def test_the_dump_is_json_with_defaults_and_infinity_as_text(write: Write) -> None:
    config = load_config(write("far_cm: 20", "far_cm: inf"), ["scene.reach=inf"])
    data = dump(config)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["psf"]["far_cm"] == "inf"
    assert data["scene"]["reach"] == "inf"
    assert data["scene"]["objects"] == 3
    assert data["forward"]["max_clamped"] == 0.01
    again = config_from_dict(data, config.base_dir)
    assert again == config
    assert again.scene.params["reach"] == math.inf


def test_plain_data_have_no_place_in_messages() -> None:
    with pytest.raises(ConfigError) as caught:
        config_from_dict({"name": "a", "sed": 1, "camera": 3, "psf": {}, "scene": {}, "dataset": {"output": "o"}})
    lines = str(caught.value).splitlines()
    assert "camera: got 3; expected a mapping of keys to values" in lines
    assert any(line.startswith("sed: unknown key, got 1") for line in lines)


def test_objects_that_are_no_plain_data_are_refused() -> None:
    with pytest.raises(InputError, match=r"^configuration: "):
        config_from_dict({"name": Path("x")})


def test_foreign_code_is_not_run_when_asked(write: Write, tmp_path: Path) -> None:
    path = write()
    data = dump(load_config(path))
    ran = tmp_path / "ran"
    (tmp_path / "plugins.py").write_text(f"open({str(ran)!r}, 'w')\n", encoding="utf-8")
    config = config_from_dict(data, tmp_path, check_plugins=False)
    assert config.camera.mask is not None
    assert config.camera.mask.params["width_mm"] == 2
    assert not ran.exists()
    with pytest.raises(InputError, match="no function 'mask'"):  # the counter-check: with the check it does run
        config_from_dict(data, tmp_path)
    assert ran.exists()


depths = st.floats(0.2, 1e6)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(
    seed=st.integers(0, 2**63 - 1),
    name=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=20),
    psf=st.lists(depths, min_size=1, max_size=5, unique=True).flatmap(
        lambda planes: st.sampled_from([sorted(planes), [*sorted(planes), math.inf]]).map(lambda p: {"depths_cm": p})
    )
    | st.tuples(
        depths, st.floats(1.001, 10), st.integers(2, 1000), st.sampled_from(["disparity", "log", "linear"])
    ).map(lambda t: {"near_cm": t[0], "far_cm": t[0] * t[1], "depths": t[2], "spacing": t[3]}),
    noise=st.sampled_from([{"type": "none"}, {"type": "physical"}])
    | st.floats(0, 120).map(lambda db: {"type": "gaussian", "psnr_db": db})
    | st.floats(1e-9, 1).map(lambda std: {"type": "gaussian", "std": std, "quantise": True}),
    full_scale=st.just("auto") | st.floats(1e-15, 1e15),
    half=st.tuples(st.integers(1, 32), st.integers(1, 48)),
    charge=st.integers(-(2**70), 2**70),
)
def test_a_dumped_config_loads_to_the_same(write: Write, seed, name, psf, noise, full_scale, half, charge) -> None:
    path = write()
    data = dump(load_config(path))
    data["seed"], data["name"], data["psf"] = seed, name, psf
    data["camera"] |= {"noise": noise, "exposure": {"full_scale": full_scale}}
    data["camera"]["mask"]["charge"] = charge
    data["scene"]["size"] = [2 * half[0], 2 * half[1]]
    config = config_from_dict(data, path.parent)
    text = json.dumps(dump(config), allow_nan=False)
    again = config_from_dict(json.loads(text), path.parent)
    assert again == config
    assert json.dumps(dump(again), allow_nan=False) == text
    # and through YAML, which reads JSON (its numbers have the same form)
    path.write_text(text, encoding="utf-8")
    assert load_config(path) == config


def test_the_schema_describes_every_key_with_its_range() -> None:
    schema = json_schema()
    assert json.loads(json.dumps(schema, allow_nan=False)) == schema
    distance = schema["$defs"]["CameraConfig"]["properties"]["mask_to_sensor_mm"]
    assert distance["anyOf"][0]["minimum"] == 0.05
    assert distance["anyOf"][0]["maximum"] == 100
    assert "millimetres" in distance["description"]
    assert schema["$defs"]["SensorConfig"]["additionalProperties"] is False
    for section in schema["$defs"].values():
        assert section["description"]
        for key, entry in section["properties"].items():
            assert key == "type" or "description" in entry or "$ref" in entry or "discriminator" in entry, key


def test_the_shipped_file_loads(tmp_path: Path) -> None:
    text = default_config_text()
    path = tmp_path / "sim_config.yaml"
    path.write_text(text, encoding="utf-8")
    config = load_config(path)
    assert config.name == "flying_things_phlatcam"
    assert config.camera.mask is not None
    assert (config.camera.mask.design, config.scene.family) == ("phlatcam", "flying_things")
    assert load_config(Path(__file__).parents[3] / "sim_config.yaml").scene == config.scene  # the one of the checkout


def test_importing_the_config_loads_nothing_heavy() -> None:
    code = "import sys, simulator.config, simulator.plugins; print([m for m in sys.modules if '.' not in m])"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    for heavy in ("scipy", "mitsuba", "torch", "colour", "matplotlib", "skimage", "psf_library", "scenes"):
        assert f"'{heavy}'" not in loaded
