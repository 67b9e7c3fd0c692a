"""What a data set has before its first sample: its folder, description, PSF stacks and exposure; and what is refused."""

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psf_library import load_psf_stack
from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.checksums import CHECKSUMS
from simulator.dataset.preparation import data_set_stack
from simulator.errors import InputError
from simulator.optics.stack import UNPROVEN

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SLOW = {"family": "./plugins.py:boxes", "size": [16, 20]}


def test_an_unproven_stack_makes_no_data_set(trial) -> None:
    assembly = Assembly(load_config(trial.write()))
    stack = replace(assembly.psf_stack, provenance=assembly.psf_stack.provenance | {"sampling": UNPROVEN})
    with pytest.raises(InputError, match=r"^psf: "):
        data_set_stack(assembly.having(psf_stack=stack), trial.folder / "out", lambda _: None)
    assert not (trial.folder / "out").exists()


def test_exposure_is_found_once(trial) -> None:
    root = trial.generate(camera={"exposure": {"full_scale": "auto"}})
    first = json.loads((root / "dataset.json").read_text())["exposure"]
    assert (first["from"], first["pilots"], first["percentile"], first["target"]) == ("pilots", 16, 99.9, 0.8)
    trial.generate(camera={"exposure": {"full_scale": "auto"}}, dataset={"train": 4})
    assert json.loads((root / "dataset.json").read_text())["exposure"] == first
    assert {sample.metadata["full_scale"] for sample in open_dataset(root)} == {first["full_scale"]}


class TestRefusals:
    """Every refusal leaves the folder as it was."""

    @pytest.fixture
    def refused(self, trial, tree) -> Callable[..., str]:
        """Return a function that runs a changed configuration, expects a refusal, and returns its message."""

        def run(*overrides: str, **changes) -> str:
            path = trial.write(**changes)
            before = tree(trial.folder)
            with pytest.raises(InputError) as caught:
                generate(path, overrides)
            assert tree(trial.folder) == before
            return str(caught.value)

        return run

    @pytest.mark.parametrize(
        ("edit", "overrides", "words"),
        [
            ("", ["camera.noise.psnr_db=30", "camera.mask.arm=20"], ["psnr_db: 40", "camera.mask.arm: 30 -> 20"]),
            ("\n# edited\n", [], ["inputs.plugins.py"]),
            ("", ["dataset.train=2"], ["dataset.train: got 2", "3"]),
        ],
    )
    def test_a_folder_that_holds_another_data_set(
        self, trial, refused, edit: str, overrides: list, words: list
    ) -> None:
        trial.generate()
        trial.plugins.write_text(trial.plugins.read_text() + edit)
        message = refused(*overrides)
        assert all(word in message for word in words), message

    def test_foreign_files(self, trial, refused) -> None:
        (trial.folder / "out").mkdir()
        (trial.folder / "out" / "thesis.tex").write_text("years of work")
        assert "thesis.tex" in refused()

    @pytest.mark.parametrize("own", ["psf/calibration.tif", "psf", "psf_captured", "writers/thesis.tex"])
    def test_a_folder_of_psfs_that_is_the_users(self, trial, refused, own: str) -> None:
        """Files of their own below the names that we use; also a whole stack, as `flatlight psf --output` writes it."""
        path = trial.folder / "out" / own
        if path.suffix:
            path.parent.mkdir(parents=True)
            path.write_text("years of work")
        else:
            data_set_stack(Assembly(load_config(trial.write())), trial.folder / "other", lambda _: None)
            path.parent.mkdir()
            (trial.folder / "other/psf").rename(path)
        assert "holds other files" in refused()
        assert "holds other files" in refused("dataset.engine=local")

    def test_a_folder_that_cannot_be_read(self, trial, monkeypatch) -> None:
        root = trial.generate()
        look = Path.exists

        def denied(path: Path, **options: bool) -> bool:
            if root in path.parents:
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return look(path, **options)

        monkeypatch.setattr(Path, "exists", denied)
        with pytest.raises(InputError, match=f"^{root}: cannot be read: Permission denied"):
            generate(trial.path)

    def test_a_lost_description(self, trial, refused) -> None:
        root = trial.generate()
        (root / "dataset.json").unlink()
        assert refused().startswith("dataset.output: ")
        for split in ("train", "validation", "test"):  # nor does a manifest alone pass for finished samples
            shutil.rmtree(root / split)
        for name in (CHECKSUMS, "croissant.json", "README.md"):
            (root / name).unlink()
        assert "manifest.jsonl" in refused()

    def test_a_file_in_place_of_the_folder(self, trial, refused) -> None:
        (trial.folder / "out").write_text("a file")
        assert "is a file" in refused()
        assert "is a file" in refused(dataset={"output": "out/deeper"})

    def test_a_place_where_nothing_can_be_written(self, trial) -> None:
        with pytest.raises(InputError, match="flatlight: "):
            generate(trial.write(), ["dataset.output=/proc/flatlight"])

    @pytest.mark.parametrize("there", [False, True])
    @pytest.mark.parametrize("override", ["camera.illuminant=Bengal", "psf.accept_error=0.001"])
    def test_what_comes_out_late_leaves_no_folder_and_one_that_was_there(
        self, trial, refused, override: str, there
    ) -> None:
        if there:
            (trial.folder / "out").mkdir()
        key = override.partition("=")[0].rpartition(".")[2]
        assert key in refused(override, psf={"depths_cm": [4], "accept_error": 1})

    def test_scenes_outside_the_depths(self, refused) -> None:
        scene = SLOW | {"depth_m": 0.5}
        message = refused(camera={"exposure": {"full_scale": "auto"}}, scene=scene)
        assert "0.036 to 0.2 m" in message
        assert "0.5" in message
        assert "psf.far_cm" in message

    @pytest.mark.parametrize("engine", ["inline", "local"])
    def test_scenes_that_fail_while_the_exposure_is_sought(self, refused, engine: str) -> None:
        changes = {"scene": SLOW | {"fail_at": 2}, "dataset": {"engine": engine, "workers": 1}}
        message = refused(camera={"exposure": {"full_scale": "auto"}}, **changes)
        assert "no clip 2 today" in message
        assert "plugins.py:" in message

    def test_scenes_without_light(self, trial, refused) -> None:
        text = trial.plugins.read_text()
        trial.plugins.write_text(text.replace("3), 0.1,", "3), 0,").replace("rng.random(3)", "0"))
        assert "found no light" in refused(camera={"exposure": {"full_scale": "auto"}})


# A data set's two stacks: samples are made with the true one, the captured one lies beside it and is checked alike.


PSF = {"depths_cm": [3.6, 20], "wavelengths_per_channel": 1, "accept_error": 1}


@pytest.fixture(scope="module")
def captured(tmp_path_factory, make_trial):
    """A finished data set with a captured stack; the trial can go on with it."""
    trial = make_trial(tmp_path_factory.mktemp("captured"))
    return trial, trial.generate(psf=PSF | {"as_captured": {}})


def test_samples_are_made_with_the_true_stack(captured) -> None:
    _, root = captured
    true, captured = load_psf_stack(root), load_psf_stack(root, captured=True)
    assert captured.provenance["nominal_fingerprint"] == true.fingerprint
    assert open_dataset(root, "train")[0].metadata["psf"] == true.fingerprint
    change = np.linalg.norm(captured.values - true.values) / np.linalg.norm(true.values)
    assert 0.001 < change < 1
    assert verify(root).ok


def test_a_run_that_goes_on_keeps_both_and_makes_one_that_was_deleted_again(captured) -> None:
    trial, root = captured
    before = {path.name: path.read_bytes() for path in (root / "psf_captured").iterdir()}
    shutil.rmtree(root / "psf_captured")
    trial.generate(psf=PSF | {"as_captured": {}})
    assert {path.name: path.read_bytes() for path in (root / "psf_captured").iterdir()} == before


@pytest.mark.parametrize(("folder", "file"), [("psf", "depth_0000.exr"), ("psf_captured", "psf.json")])
def test_a_run_does_not_go_on_beside_a_damaged_stack(make_trial, tmp_path, folder, file) -> None:
    psf = {"depths_cm": [20], "wavelengths_per_channel": 1, "accept_error": 1, "as_captured": {}}
    trial = make_trial(tmp_path)
    root = trial.generate(psf=psf)
    with (root / folder / file).open("ab") as opened:
        opened.write(b"x")
    with pytest.raises(InputError, match=f"{folder}/{file}"):
        trial.generate(psf=psf)


def test_another_light_of_the_calibration_is_another_data_set(trial) -> None:
    lamp = trial.folder / "lamp.csv"
    lamp.write_text("400,1\n700,2\n")
    psf = PSF | {"as_captured": {"illuminant": "lamp.csv"}}
    root = trial.generate(psf=psf)
    assert trial.generate(psf=psf) == root
    lamp.write_text("400,2\n700,1\n")
    with pytest.raises(InputError, match=r"^dataset\.output: "):
        trial.generate(psf=psf)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"psf": PSF | {"as_captured": {"illuminant": "Bengal"}}}, r"^psf\.as_captured\.illuminant: "),
        ({"camera": {"scene_to_camera": [[1, 0, 0]]}}, r"^camera\.scene_to_camera: "),
    ],
)
def test_mistakes_come_out_before_the_psfs_are_computed(trial, changes, words) -> None:
    seen = []
    with pytest.raises(InputError, match=words):
        generate(trial.write(**changes), progress=lambda *update: seen.append(update))
    assert seen == []


def test_without_the_key_there_is_none(trial) -> None:
    root = trial.generate()
    assert not (root / "psf_captured").exists()
    assert verify(root).ok
    with pytest.raises(InputError, match=r"^captured: "):
        load_psf_stack(root, captured=True)


def test_damage_and_a_stack_of_another_camera_are_named(captured, tmp_path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(captured[1], root)
    path = root / "psf_captured/psf.json"
    whole = path.read_text()
    content = json.loads(whole)
    content["provenance"]["nominal_fingerprint"] = "b" * 64
    path.write_text(json.dumps(content))
    changed, line = verify(root).problems
    assert changed.startswith(f"{path}: ")
    assert line.startswith("psf_captured: captured from psf = bbb")
    path.write_text(whole)
    plane = root / "psf_captured/depth_0001.exr"
    data = bytearray(plane.read_bytes())
    data[-20] ^= 1
    plane.write_bytes(data)
    (line,) = verify(root).problems
    assert f"{plane}: " in line
    shutil.rmtree(root / "psf_captured")
    assert any(line.startswith(f"{root / 'psf_captured'}: ") for line in verify(root).problems)
