"""From the configuration to masks, cameras, stacks and scenes: units, caches, and whose mistake it was."""

import hashlib
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.design.load import load_mask
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_numbers_become_si_units(trial) -> None:
    config = load_config(trial.write(psf={"near_cm": 4, "far_cm": 20, "depths": 3, "accept_error": 0.5}))
    view, geometry = Assembly(config).view, Assembly(config).geometry
    assert view.shape == (16, 20)
    assert view.pixel_pitch_m == geometry.pixel_pitch_m == pytest.approx(19.2e-6)
    assert view.distance_m == geometry.mask_to_sensor_m == pytest.approx(1.9e-3)
    assert (view.near_m, view.far_m) == pytest.approx((0.04, 0.2))
    psf = Assembly(config).psf_config
    assert psf.depths_m == pytest.approx((0.04, 1 / 15, 0.2))  # even steps of 1/z: 25, 15, 5 per metre
    assert (psf.model, psf.wavelengths_per_channel, psf.oversampling) == ("scaled_distance", 3, 1)
    assert psf.accept_error == 0.5
    sensor = replace(Assembly(config).sensor, full_scale=2.5)
    assert (sensor.exposure_s, sensor.full_scale, sensor.binning, sensor.shape) == (5e-3, 2.5, 8, (48, 60))
    model = Assembly(config).forward_model
    assert model.shutter is not None
    assert model.shutter.exposure_s == 5e-3


@pytest.mark.parametrize(
    ("psf", "depths_m"),
    [
        ({"depths_cm": [4, 7.5, float("inf")]}, (0.04, 0.075, np.inf)),
        ({"near_cm": 5, "far_cm": 5, "depths": 1}, (0.05,)),
        ({"near_cm": 5, "far_cm": float("inf"), "depths": 3}, (0.05, 0.1, np.inf)),
        ({"near_cm": 5, "far_cm": 20, "depths": 3, "spacing": "log"}, (0.05, 0.1, 0.2)),
    ],
)
def test_depths_in_all_their_forms(trial, psf: dict, depths_m: tuple[float, ...]) -> None:
    config = load_config(trial.write(psf=psf))
    assert Assembly(config).psf_config.depths_m == pytest.approx(depths_m)
    view = Assembly(config).view
    assert (view.near_m, view.far_m) == pytest.approx((depths_m[0], depths_m[-1]))


def test_a_sensor_takes_the_numbers_that_are_given(trial) -> None:
    numbers = {"pixel_pitch_um": 3, "full_well_e": 9000, "read_noise_e": 5, "dark_current_e_per_s": 2}
    numbers |= {"prnu_percent": 2, "black_level_dn": 16, "bit_depth": 10, "dsnu_e": 2.5, "row_noise_e": 1.5}
    numbers |= {"readout": "bayer", "cfa": "GBRG", "pattern_seed": 4}
    sensor = Assembly(load_config(trial.write(camera={"sensor": {"shape": [48, 60], **numbers}}))).sensor
    assert sensor.pixel_pitch_m == pytest.approx(3e-6)
    assert (sensor.full_well_e, sensor.read_noise_e, sensor.dark_current_e_per_s) == (9000, 5, 2)
    assert (sensor.prnu, sensor.black_level_dn, sensor.bit_depth) == (0.02, 16, 10)
    assert (sensor.dsnu_e, sensor.row_noise_e, sensor.pattern_seed) == (2.5, 1.5, 4)
    assert (sensor.readout, sensor.cfa, sensor.stored_cfa) == ("bayer", "GBRG", "GRBG")
    plain = Assembly(load_config(trial.write())).sensor
    assert (plain.row_noise_e, plain.readout, plain.cfa) == (0.3, "binned_rgb", "RGGB")


@pytest.mark.parametrize("noise", [{"type": "none"}, {"type": "gaussian", "std": 0.25}, {"type": "physical"}])
def test_the_sensor_has_the_configured_noise(trial, noise: dict) -> None:
    config = load_config(trial.write(camera={"noise": noise}))
    assert Assembly(config).sensor.noise == config.camera.noise


class TestMasks:
    def test_default_and_given_parameters_are_one_design(self, trial, capfd) -> None:
        _speaking(trial)
        first = load_mask("./plugins.py:corners", trial.folder)
        again = load_mask("./plugins.py:corners", trial.folder, arm=30)
        other = load_mask("./plugins.py:corners", trial.folder, arm=31)
        assert capfd.readouterr().out.split() == ["30", "31"]
        assert np.array_equal(first.amplitude, again.amplitude)
        assert first.digest() == again.digest() != other.digest()
        assert (again.pitch_m, again.profile, again.name) == (4e-6, "staircase", "corners")
        assert again.material == first.material

    def test_an_edited_design_is_made_again(self, trial, capfd) -> None:
        _speaking(trial)
        first = load_mask("./plugins.py:corners", trial.folder)
        trial.plugins.write_text(trial.plugins.read_text().replace("column + 6] = 1", "column + 6] = 0.5"))
        assert load_mask("./plugins.py:corners", trial.folder).amplitude.sum() < first.amplitude.sum()
        assert capfd.readouterr().out.split() == ["30", "30"]

    def test_a_file_that_a_parameter_names_counts(self, trial) -> None:
        trial.plugins.write_text(
            "from pathlib import Path\nimport numpy as np\nfrom simulator.optics.mask import Mask\n"
            "def drawn(*, file: Path) -> Mask:\n"
            "    open_ = np.loadtxt(file, dtype=np.float32)\n"
            "    return Mask(np.zeros_like(open_), open_, 1e-5)\n"
        )
        (trial.folder / "drawing.txt").write_text("0 1\n1 1")
        load = partial(load_mask, "./plugins.py:drawn", trial.folder, file="drawing.txt")
        assert load().amplitude.tolist() == [[0, 1], [1, 1]]
        (trial.folder / "drawing.txt").write_text("1 0\n1 1")
        assert load().amplitude.tolist() == [[1, 0], [1, 1]]
        config = load_config(
            trial.write(
                camera={"mask": {"design": "./plugins.py:drawn", "file": "drawing.txt"}},
                scene={"source": "flyingthings3d", "path": str(_frames(trial.folder)), "size": [4, 4]},
            )
        )
        names = [path.name for path in Assembly(config, "none").input_files]
        assert names == ["plugins.py", "drawing.txt", "f.png", "f.pfm"]

    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("return 3", "returned int, expected a simulator.optics.mask.Mask"),
            ("return Mask(np.full((4, 4), np.nan), np.ones((4, 4)), 1e-6)", "height_m"),
            ("return 1 / 0", "plugins.py:4: ZeroDivisionError"),
            ("import nothing_of_this_name", "ModuleNotFoundError"),
        ],
    )
    def test_a_broken_design_is_named(self, trial, body: str, words: str) -> None:
        trial.plugins.write_text(
            f"import numpy as np\nfrom simulator.optics.mask import Mask\ndef corners():\n    {body}\n"
        )
        with pytest.raises(InputError) as caught:
            load_mask("./plugins.py:corners", trial.folder)
        assert words in str(caught.value)
        assert "./plugins.py:corners" in str(caught.value)


class TestStacks:
    def test_a_stack_is_computed_once(self, trial) -> None:
        config = load_config(trial.write(psf={"depths_cm": [4, 6], "accept_error": 1.01}))
        calls: list[tuple[str, int, int]] = []
        first = Assembly(config, progress=lambda *at: calls.append(at)).psf_stack
        assert sorted(calls) == [("PSFs", i, 18) for i in range(1, 19)]
        again = Assembly(config, progress=lambda *at: calls.append(at)).psf_stack
        assert len(calls) == 18
        assert np.array_equal(first.values, again.values)
        assert first.fingerprint == again.fingerprint
        assert first.provenance == again.provenance

    @pytest.mark.slow
    def test_some_depths_are_those_of_the_whole_stack(self, trial, tmp_path: Path, monkeypatch) -> None:
        """Computed alone, or taken from the whole where that is there: the same light, errors and fingerprint."""
        psf = {"depths_cm": [4, 5, 6, 8], "wavelengths_per_channel": 1, "accept_error": 1}
        config = load_config(trial.write(psf=psf))
        calls: list[tuple[str, int, int]] = []
        monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "alone"))
        alone = Assembly(config, progress=lambda *at: calls.append(at)).some_depths(3)
        assert calls[-1] == ("PSFs", 9, 9)
        np.testing.assert_allclose(alone.depths_m, [0.04, 0.06, 0.08])
        monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "whole"))
        whole, calls = Assembly(config).psf_stack, []
        taken = Assembly(config, progress=lambda *at: calls.append(at)).some_depths(3)
        assert not calls
        np.testing.assert_array_equal(taken.values, whole.values[[0, 2, 3]])
        np.testing.assert_array_equal(taken.values, alone.values)
        assert taken.provenance == alone.provenance
        assert taken.fingerprint == alone.fingerprint
        assert set(alone.provenance["errors"]) == {"check", "model", "spectrum"} < set(whole.provenance["errors"])

    def test_some_depths_of_a_measured_stack(self, trial) -> None:
        images = np.random.default_rng(0).random((4, 12, 16))
        np.save(trial.folder / "psf.npy", images)
        psf = {"measured": ["psf.npy"], "depths_cm": [4, 5, 6, 8], "frame": "stored", "background": "none"}
        config = load_config(trial.write(camera={"mask": None}, psf=psf | {"throughput_mm2": 0.5}))
        some, whole = Assembly(config).some_depths(2), Assembly(config).psf_stack
        np.testing.assert_allclose(some.depths_m, [0.04, 0.08])
        np.testing.assert_array_equal(some.values, whole.values[[0, 3]])
        assert some.fingerprint != whole.fingerprint

    @pytest.mark.slow
    def test_threads_change_nothing(self, trial) -> None:
        values = []
        for threads, error in ((1, 1.02), (2, 1.03)):  # another limit: not from the cache
            config = load_config(trial.write(psf={"depths_cm": [4], "accept_error": error}))
            values.append(Assembly(config, threads=threads).psf_stack.values)
        assert np.array_equal(values[0], values[1])

    @pytest.mark.slow
    def test_a_stack_accepted_under_a_loose_limit_does_not_pass_a_tight_one(self, trial) -> None:
        for limit in (1, 0.001):
            config = load_config(
                trial.write(psf={"depths_cm": [4], "wavelengths_per_channel": 1, "accept_error": limit})
            )
            if limit == 1:
                _ = Assembly(config).psf_stack
            else:
                with pytest.raises(InputError, match=r"^psf\.oversampling: "):
                    _ = Assembly(config).psf_stack

    def test_a_measured_stack(self, trial) -> None:
        image = np.zeros((12, 16))
        image[3, 12] = 5.0
        np.save(trial.folder / "psf.npy", image)
        psf = {"measured": ["psf.npy"], "depths_cm": [float("inf")], "frame": "physical", "background": "none"}
        config = load_config(trial.write(camera={"mask": None}, psf=psf | {"throughput_mm2": 0.5}))
        assert Assembly(config).mask is None
        stack = Assembly(config).psf_stack
        # Rotated by 180 degrees about the origin (6, 8): (-3, 4) from it becomes (3, -4). Row and column 0 have no partner.
        assert stack.values.shape == (1, 3, 11, 15)
        assert np.argwhere(stack.values[0, 0]).tolist() == [[5 + 3, 7 - 4]]
        assert stack.energy_m2() == pytest.approx(0.5e-6)
        assert Assembly(config).view.far_m == np.inf
        source = Assembly(config, "none").source
        assert [path.name for path in Assembly(config).having(source=source).input_files] == ["plugins.py", "psf.npy"]


class TestSources:
    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("return 3", "returned int, expected an object with inputs and clip"),
            ("return 1 / 0", "plugins.py:2: ZeroDivisionError"),
        ],
    )
    def test_a_broken_family_is_named(self, trial, body: str, words: str) -> None:
        path = trial.write(camera={"mask": {"design": "pinhole"}})
        trial.plugins.write_text(f"def boxes(view):\n    {body}\n")
        with pytest.raises(InputError) as caught:
            _ = Assembly(load_config(path), "none").source
        assert words in str(caught.value)
        assert "./plugins.py:boxes" in str(caught.value)

    def test_what_is_wrong_with_the_camera_is_not_blamed_on_the_family(self, trial) -> None:
        with pytest.raises(InputError, match=r"^(?!scene).*gone: "):
            _ = Assembly(load_config(trial.write(camera={"mask": None}, psf={"measured": "gone"}))).source

    def test_a_renderer_goes_to_those_who_want_it(self, trial) -> None:
        path = trial.write(scene={"family": "flying_things", "size": [16, 20]})
        source = Assembly(load_config(path), "scalar_rgb").source
        assert source.renderer.backend == "scalar_rgb"
        assert not Assembly(load_config(trial.write())).scene_plugin.takes_renderer

    @pytest.mark.parametrize(
        ("render", "fields"),
        [
            ({}, {"outputs": (), "hidden": 1, "denoise": False, "bands_nm": ()}),
            ({"outputs": ["normal", "hidden"]}, {"outputs": ("normal", "hidden"), "hidden": 1}),
            ({"outputs": ["hidden"], "hidden_layers": 3}, {"outputs": ("hidden",), "hidden": 3}),
            ({"denoise": True}, {"denoise": True, "outputs": (), "bands_nm": ()}),
            ({"bands": {"from_nm": 400, "to_nm": 700, "count": 3}}, {"bands_nm": (400, 500, 600, 700)}),
        ],
    )
    def test_what_is_asked_of_rendering_reaches_the_renderer(
        self, trial, monkeypatch: pytest.MonkeyPatch, render: dict, fields: dict
    ) -> None:
        monkeypatch.setattr("simulator.render.renderer.check_denoiser", lambda: None)  # it need not be installed
        scene = {"family": "flying_things", "size": [16, 20]}
        config = load_config(trial.write(scene=scene, render={"backend": "scalar"} | render))
        variant = "scalar_spectral" if "bands" in render else "scalar_rgb"
        renderer = Assembly(config, variant).source.renderer
        assert {name: getattr(renderer, name) for name in fields} == fields
        assert renderer.backend == variant


@pytest.mark.parametrize(
    ("camera", "key"),
    [
        ({"illuminant": "Bengal"}, "camera.illuminant"),
        ({"sensor": {"shape": [48, 60], "spectral_response": "eye"}}, "camera.sensor.spectral_response"),
    ],
)
def test_unknown_names_list_the_known_ones(trial, camera: dict, key: str) -> None:
    config = load_config(trial.write(camera=camera))
    with pytest.raises(InputError, match=f"^{re.escape(key)}: "):
        _ = Assembly(config).geometry


def _speaking(trial) -> None:
    text = trial.plugins.read_text()
    # A number of this trial's own keeps the designs of other tests out of the cache's way.
    own = hashlib.sha256(str(trial.folder).encode()).hexdigest()
    trial.plugins.write_text(
        text.replace("    amplitude = np.zeros", f"    print(arm)  # {own}\n    amplitude = np.zeros")
    )


def _frames(folder: Path) -> Path:
    from PIL import Image

    for name in ("RGB_cleanpass", "disparity"):
        (folder / "frames" / name / "left").mkdir(parents=True)
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "frames/RGB_cleanpass/left/f.png")
    data = np.arange(1, 65, dtype="<f4").tobytes()
    (folder / "frames/disparity/left/f.pfm").write_bytes(b"Pf\n8 8\n-1.0\n" + data)
    return folder / "frames"


def test_a_material_of_the_users_own_survives_the_cache(trial) -> None:
    """Only its name would not do: another material of a known name would come back as the known one."""
    glass = 'Material("fused-silica", "cauchy", (1.9,), (3e-7, 9e-7), "mine")'
    trial.plugins.write_text(
        "import numpy as np\nfrom simulator.optics.mask import Mask\nfrom simulator.optics.materials import Material\n"
        f"def slab() -> Mask:\n    return Mask(np.zeros((9, 9)), np.ones((9, 9)), 2e-6, {glass})\n"
    )
    for _ in range(2):  # designed, then from the cache
        mask = load_mask("./plugins.py:slab", trial.folder)
        assert mask.material.index(532e-9) == 1.9
        assert mask.name == "slab"


def test_a_scene_may_have_depths_of_its_own(trial) -> None:
    """A flat PSF (one plane) says nothing of the depths that scenes fill."""
    scene = {"family": "flying_things", "size": [16, 20], "near_cm": 5, "far_cm": 30, "samples_per_pixel": 1}
    config = load_config(trial.write(psf={"depths_cm": [float("inf")]}, scene=scene))
    clip = Assembly(config, "scalar_rgb").source.clip(0, np.random.default_rng(0))
    assert 0.05 < clip.depth_m.min() < clip.depth_m.max() <= 0.3
    for nowhere in ({"near_cm": None, "far_cm": None}, {"near_cm": 5, "far_cm": 5.1}):
        config = load_config(trial.write(psf={"depths_cm": [float("inf")]}, scene=_without_none(scene | nowhere)))
        with pytest.raises(InputError, match=r"^scene: "):
            Assembly(config, "scalar_rgb").source.clip(0, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"scene\.near_cm: .*far_cm"):
        load_config(trial.write(scene=scene | {"near_cm": 40}))


def test_a_measurement_that_was_not_binned_is_refused(trial) -> None:
    """A full image of the sensor taken for a binned one would be a PSF eight times too wide."""
    image = np.zeros((1, 900, 700), np.uint16)
    image[0, 450, 350] = 1000
    np.save(trial.folder / "psf.npy", image)
    psf = {"measured": ["psf.npy"], "depths_cm": [10], "frame": "physical", "throughput_mm2": 1.0}
    camera = {"mask": None, "sensor": {"binning": 8, "shape": [48, 60]}}
    with pytest.raises(InputError, match=r"^psf\.binning: "):
        _ = Assembly(load_config(trial.write(psf=psf, camera=camera))).psf_stack
    fine = load_config(trial.write(psf=psf | {"binning": 2}, camera=camera))
    assert Assembly(fine).psf_stack.values.shape[-2:] == (449, 349)


def _without_none(section: dict) -> dict:
    return {key: value for key, value in section.items() if value is not None}
