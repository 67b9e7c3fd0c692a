"""Every preset of a training can be loaded, and its first line says what it is for."""

from __future__ import annotations

import re
import shlex
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from learning.config import (
    FEWEST_SCENES,
    DenoiserConfig,
    EvaluateConfig,
    NetworkConfig,
    RecognitionConfig,
    SwapConfig,
    TrainConfig,
    TuneConfig,
    Video3DTrainConfig,
    VideoNetworkConfig,
    VideoTrainConfig,
    evaluation_kind,
    load_file,
    training_kind,
)
from learning.models.videonet import VIDEO_SIZES
from learning.presets import preset_texts
from scenes.endoscopy.organs import ORGANS
from simulator.config import Config, load_config
from simulator.presets import preset_names, preset_text


@pytest.mark.parametrize("name", sorted(name for name, text in preset_texts().items() if "\n# Train: " in text))
def test_preset(name: str, tmp_path: Path) -> None:
    text = preset_texts()[name]
    denoiser = name.startswith("denoiser")
    config = load_file(DenoiserConfig if denoiser else training_kind, _written(name, tmp_path))
    assert text.startswith("# ")
    assert f"flatlight {'train-denoiser' if denoiser else 'train'} FILE" in text
    assert config.output == f"out/{name}"
    outputs = {yaml.safe_load(preset_text(each))["dataset"]["output"] for each in preset_names()}
    assert config.data.train in outputs  # what `flatlight generate` writes beside it


def test_names_are_offered_and_not_taken() -> None:
    assert not set(preset_texts()) & set(preset_names())
    offered = preset_names(others=True)
    assert set(preset_texts()) <= set(offered)
    assert len(offered) == len(set(offered))


def _written(name: str, tmp_path: Path) -> Path:
    path = tmp_path / f"{name}.yaml"
    path.write_text(preset_texts()[name], encoding="utf-8")
    return path


def test_the_tuning_is_on_the_validation_split_of_the_training_data(tmp_path: Path) -> None:
    config = load_file(TuneConfig, _written("tune_64", tmp_path))
    assert "flatlight tune FILE" in preset_texts()["tune_64"]
    assert str(config.data.validation) == yaml.safe_load(preset_text("flying_things_64"))["dataset"]["output"]
    assert config.data.split == "validation"


def test_the_refinement_goes_on_from_what_the_training_writes(tmp_path: Path) -> None:
    first, further = (
        load_file(TrainConfig, _written(name, tmp_path)) for name in ("flatnet3d_64", "flatnet3d_refined_64")
    )
    assert further.init_from == f"{first.output}/best.safetensors"
    assert further.network.numbers == first.network.numbers | {"refinements": 2, "repeats": 1}
    assert further.data == first.data
    assert further.loss == first.loss.model_copy(update={"multiscale_weight": 6.0})


def test_the_evaluation_reads_what_trainings_and_tuning_write(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_64", tmp_path))
    presets = preset_texts()
    networks = ("flatnet3d_refined_64", "flatnet3d_64", "flatnet2d_64")
    for method, preset in zip(config.methods, networks, strict=False):
        output = yaml.safe_load(presets[preset])["output"]
        assert method.checkpoints is not None
        assert method.checkpoints[0] == f"{output}/best.safetensors"
        assert len(method.checkpoints) == 3
    tuning = load_file(TuneConfig, _written("tune_64", tmp_path))
    assert [method.classical for method in config.methods[len(networks) :]] == tuning.methods == ["cls", "admm", "pnp"]
    assert {method.tuned for method in config.methods[len(networks) :]} == {str(tuning.output)}
    assert config.noise_db == tuning.noise_db
    assert config.data.training == yaml.safe_load(preset_text("flying_things_64"))["dataset"]["output"]


def _commands(preset: str, verb: str) -> list[list[str]]:
    """Return the words after `flatlight VERB` at a preset's head, the shell's loops unrolled."""
    comments = (line[1:] for line in preset_texts()[preset].splitlines() if line.startswith("#"))
    lines = []
    for line in "\n".join(comments).replace("\\\n", " ").splitlines():
        loop = re.search(r"for (\w+) in (.*); do (.*); done", line)
        lines += [loop[3].replace(f"${loop[1]}", word) for word in loop[2].split()] if loop else [line]
    found = (call for line in lines for call in re.findall(rf"flatlight {verb} ([^(&]*)", line))
    return [shlex.split(call) for call in found]


def _made(preset: str, data: str, folder: Path) -> list[Config]:
    """Return the data sets of one preset of the simulator that the commands at a preset's head make."""
    path = folder / f"{data}.yaml"
    path.write_text(preset_text(data), encoding="utf-8")
    commands = [words for words in _commands(preset, "generate") if words[0] == path.name]
    overrides = [[word for before, word in pairwise(words) if before == "--set"] for words in commands]
    return [load_config(path, words) for words in overrides]


def test_the_commands_at_its_head_make_the_data_that_it_reads(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_64", tmp_path))
    made = _made("evaluate_64", "flying_things_64", tmp_path)
    assert [str(one.dataset.output) for one in made] == [config.data.training, config.data.test]
    assert made[0].psf.as_captured is not None  # pyright: ignore[reportAttributeAccessIssue]
    assert (made[1].psf.model, made[1].psf.depths) == ("exact", 25)  # pyright: ignore[reportAttributeAccessIssue]
    assert (made[1].dataset.train, made[1].dataset.validation, made[1].dataset.test) == (0, 0, 240)


def test_the_evaluation_of_clips_reads_what_training_and_tuning_write(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_video_64", tmp_path))
    training = load_file(VideoTrainConfig, _written("videonet_64", tmp_path))
    tuning = load_file(TuneConfig, _written("tune_video_64", tmp_path))
    network, stacked, polished, begun, *rivals = config.methods
    outputs = [training.output, *(f"{training.output}_seed{seed}" for seed in (1, 2))]
    assert network.checkpoints == [f"{output}/best.safetensors" for output in outputs]
    assert stacked.checkpoints == [f"{training.output}_stack/best.safetensors"]
    assert (polished.classical, polished.parameters) == (
        "pnp_clips",
        {"initial_estimate": f"{training.output}/best.safetensors"},
    )
    assert begun.parameters == {"iterations": VIDEO_SIZES["compact"]["joint_iterations"]}
    assert {rival.classical for rival in rivals} == set(tuning.methods)
    assert {rival.tuned for rival in rivals} == {str(tuning.output)}
    assert (config.noise_db, tuning.objective) == (None, "image")
    (noise,) = [words for words in _commands("evaluate_video_64", "evaluate") if len(words) > 1 and words[1] == "--set"]
    noisy = load_file(EvaluateConfig, _written("evaluate_video_64", tmp_path), noise[2::2])
    assert noisy.noise_db == tuning.noise_db
    assert noisy.output != config.output
    known, test = _made("evaluate_video_64", "high_speed_64", tmp_path)
    assert str(known.dataset.output) == config.data.training == training.data.train == str(tuning.data.validation)
    assert str(test.dataset.output) == config.data.test
    assert (test.psf.model, test.psf.depths) == ("exact", 5)  # pyright: ignore[reportAttributeAccessIssue]
    assert (test.dataset.train, test.dataset.validation, test.dataset.test) == (0, 0, 128)
    assert known.dataset.ground_truth == test.dataset.ground_truth == "frames"  # to be re-simulated; for motion
    assert test.render.outputs == ("motion",)


def test_moving_scenes_are_judged_through_psfs_that_are_new_and_as_they_stand_still(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_moving_3d_64", tmp_path))
    training = load_file(Video3DTrainConfig, _written("videonet3d_64", tmp_path))
    known, test, still = _made("evaluate_moving_3d_64", "moving_3d_64", tmp_path)
    assert str(known.dataset.output) == config.data.training == training.data.train
    assert str(test.dataset.output) == config.data.test == still.scene.params["path"]
    assert still.scene.params["still"] is True
    for one in (test, still):
        assert (one.psf.model, one.psf.depths) == ("exact", 25)  # pyright: ignore[reportAttributeAccessIssue]
        assert (one.dataset.train, one.dataset.validation, one.dataset.test) == (0, 0, 64)
    network, both, flat, joint = config.methods
    assert network.checkpoints == [f"{training.output}/best.safetensors"]
    assert both.checkpoints == flat.checkpoints == [training.init_from]
    (video,) = _commands("evaluate_moving_3d_64", "train")
    rival = load_file(VideoTrainConfig, _written("videonet_64", tmp_path), video[2::2])
    assert both.frames == f"{rival.output}/best.safetensors"
    assert rival.data.train == training.data.train
    (words,) = _commands("evaluate_moving_3d_64", "psf")
    assert words[words.index("--output") + 1] == rival.data.stack
    (tune,) = _commands("evaluate_moving_3d_64", "tune")
    tuning = load_file(TuneConfig, _written("tune_video_64", tmp_path), tune[2::2])
    assert [joint.classical] == tuning.methods
    assert joint.tuned == str(tuning.output)
    assert str(tuning.data.validation) == training.data.train
    assert tuning.objective == "both"
    (stopped,) = [words for words in _commands("evaluate_moving_3d_64", "evaluate") if "--set" in words[1:2]]
    assert load_file(EvaluateConfig, _written("evaluate_moving_3d_64", tmp_path), stopped[2::2]).data.test == str(
        still.dataset.output
    )


def test_the_thesis_s_network_learns_from_clips_of_its_sizes_on_one_plane(tmp_path: Path) -> None:
    config = load_file(VideoTrainConfig, _written("videonet_thesis", tmp_path))
    (made,) = _made("videonet_thesis", "video_thesis", tmp_path)
    assert str(made.dataset.output) == config.data.train
    assert made.psf.depths_cm == (30.0,)  # pyright: ignore[reportAttributeAccessIssue]
    assert config.loss.model_dump()["intensity"] == "mse"
    weights = [getattr(config.loss, f"{name}_weight") for name in ("measurement", "intensity", "perceptual")]
    assert weights == [1, 5, 0.1]


def test_films_are_judged_by_two_small_trainings_at_the_thesis_s_sizes(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_video_thesis", tmp_path))
    (rendered,) = _made("evaluate_video_thesis", "video_thesis", tmp_path)
    (films,) = _made("evaluate_video_thesis", "youtube_vos", tmp_path)
    assert (str(rendered.dataset.output), str(films.dataset.output)) == (config.data.training, config.data.test)
    assert films.scene.source == "davis"  # pyright: ignore[reportAttributeAccessIssue]
    assert rendered.psf.depths_cm == films.psf.depths_cm == (30.0,)  # pyright: ignore[reportAttributeAccessIssue]
    assert rendered.camera == films.camera
    assert (films.dataset.train, films.dataset.validation) == (0, 0)
    path = _written("videonet_thesis", tmp_path)
    thesis, today = (
        load_file(VideoTrainConfig, path, words[2::2]) for words in _commands("evaluate_video_thesis", "train")
    )
    assert (thesis.network.size, today.network.size) == ("thesis", "compact")
    assert (thesis.steps, thesis.batch, thesis.data) == (today.steps, today.batch, today.data)
    checkpoints = [method.checkpoints for method in config.methods[:2]]
    assert checkpoints == [[f"{each.output}/best.safetensors"] for each in (today, thesis)]
    begun = config.methods[2].parameters
    assert begun == {"iterations": VIDEO_SIZES["compact"]["joint_iterations"]}


def test_three_organs_are_judged_through_psfs_and_in_scenes_that_are_new(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_endoscopy_64", tmp_path))
    colon, *tests = _made("evaluate_endoscopy_64", "endoscopy_64", tmp_path)
    assert isinstance(config.data.test, dict)
    assert str(colon.dataset.output) == config.data.training
    assert colon.scene.params["organ"] == "colon"
    assert colon.dataset.validation >= FEWEST_SCENES
    organs = {str(one.scene.params["organ"]).replace("_", " "): str(one.dataset.output) for one in tests}
    assert list(organs.items()) == list(config.data.test.items())
    assert {name.replace(" ", "_") for name in organs} == set(ORGANS)
    for one in tests:
        assert (one.dataset.train, one.dataset.validation, one.dataset.test) == (0, 0, 96)
        assert one.seed != colon.seed
        seen, known = (each.psf.depths_m for each in (one, colon))  # pyright: ignore[reportAttributeAccessIssue]
        assert set(np.round(seen, 9)) & set(np.round(known, 9)) == set(np.round([known[0], known[-1]], 9))


def test_the_trainings_and_the_tuning_for_endoscopy_are_the_methods_that_are_judged(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_endoscopy_64", tmp_path))
    path = _written("endoscopy_fine_tuning_64", tmp_path)
    commands = _commands("endoscopy_fine_tuning_64", "train")
    taught, scratch, untaught = (load_file(TrainConfig, path, words[2::2]) for words in commands)
    outputs = [each.output for each in (taught, scratch, untaught)]
    assert [[f"{output}/best.safetensors"] for output in outputs] == [each.checkpoints for each in config.methods[:3]]
    assert taught.init_from == f"{yaml.safe_load(preset_texts()['flatnet3d_64'])['output']}/best.safetensors"
    assert scratch.init_from is None
    assert (scratch.steps, scratch.data, scratch.loss) == (taught.steps, taught.data, taught.loss)
    assert untaught.init_from == taught.init_from
    assert (untaught.steps, untaught.optimiser.learning_rate) == (1, 1e-9)
    (words,) = _commands("endoscopy_fine_tuning_64", "tune")
    tuning = load_file(TuneConfig, _written("tune_64", tmp_path), words[2::2])
    assert [method.classical for method in config.methods[3:]] == tuning.methods
    assert {method.tuned for method in config.methods[3:]} == {str(tuning.output)}
    assert str(tuning.data.validation) == taught.data.train == config.data.training
    noise = yaml.safe_load(preset_text("endoscopy_64"))["camera"]["noise"]
    assert tuning.noise_db == [noise["psnr_db"]]


def test_masks_are_compared_by_scenes_and_a_network_of_other_presets(tmp_path: Path) -> None:
    config = load_file(SwapConfig, _written("masks_64", tmp_path))
    evaluation = load_file(EvaluateConfig, _written("evaluate_64", tmp_path))
    assert (config.scenes.train, config.scenes.test) == (evaluation.data.training, evaluation.data.test)
    training = load_file(TrainConfig, _written("flatnet3d_64", tmp_path))
    assert config.network is not None
    assert config.network.init_from == f"{training.output}/best.safetensors"
    assert config.network.loss == training.loss
    camera = tmp_path / config.config
    camera.write_text(preset_text(camera.stem), encoding="utf-8")
    made = {}
    for name, mask in config.masks.items():
        made[name] = load_config(camera, [f"camera.mask={mask}", *config.settings, *config.test_settings])
    assert {each.camera.mask.design for each in made.values()} == {  # pyright: ignore[reportOptionalMemberAccess]
        *("phlatcam", "diffusercam", "flatcam", "random_lenslets"),
    }
    assert {(each.psf.model, each.camera.noise.type) for each in made.values()} == {("exact", "physical")}  # pyright: ignore[reportAttributeAccessIssue]


FLATNET3D_PARTS = {
    **{"unet": "network", "lambda": "network", "joint": "network", "head": "network"},
    **{"augment": "data", "cm": "loss", "clip": "data"},
}
VIDEONET_PARTS = {
    **dict.fromkeys(
        ("static", "slivers", "measnet", "static_measnet", "slivers_measnet", "unrefined", "stack"), "network"
    ),
    **{"l1": "loss", "change": "loss"},
}


def _unrolled(loop: re.Match[str]) -> str:
    """Return the commands of bash's loop over seeds, one to a line."""
    return "\n ".join(loop[2].replace("$seed", seed) for seed in loop[1].split())


@pytest.mark.parametrize(
    ("preset", "network", "parts"),
    [("ablation_64", "flatnet3d", FLATNET3D_PARTS), ("ablation_video_64", "videonet", VIDEONET_PARTS)],
)
def test_each_ablation_changes_one_part_and_is_evaluated(
    preset: str, network: str, parts: dict[str, str], tmp_path: Path
) -> None:
    """The trainings at the head, as bash would run them, give the checkpoints of each method, and differ as it says."""
    config = load_file(EvaluateConfig, _written(preset, tmp_path))
    head = "\n".join(line[1:] for line in preset_texts()[preset].splitlines() if line.startswith("#"))
    (common,) = re.findall(r"ablate\(\) \{ flatlight train \S+ (.*) \"\$\{@:2\}\"; \}", head.replace("\\\n", " "))
    script = re.sub(r"for seed in ([\d ]+); do\s+(.*?);?\s+done", _unrolled, head.replace("\\\n", " "), flags=re.DOTALL)
    path = _written(f"{network}_64", tmp_path)
    made: dict[str, list[TrainConfig | VideoTrainConfig]] = {}
    for name, words in re.findall(r"^ +ablate ([a-z]\S*) ?(.*)$", script, flags=re.MULTILINE):
        training = load_file(training_kind, path, shlex.split(f"{common} {words}".replace("$1", name))[1::2])
        assert training.steps == 2000
        made.setdefault(re.sub(r"_\d$", "", name), []).append(training)
    for method, trainings in zip(config.methods, made.values(), strict=True):
        assert method.checkpoints == [f"{training.output}/best.safetensors" for training in trainings]
        assert [training.seed for training in trainings] == list(range(len(trainings)))
    plain = made["preset"][0].dump()
    assert made.keys() == {"preset", "thesis", *parts}
    for name, part in parts.items():
        changed = made[name][0].dump()
        assert {key for key in plain if changed[key] != plain[key]} == {"output", part}
        # VideoNet's start and MeasNet are changed together, too; so are refinements and repeats, a loss and its weight.
        keys = [key for key in plain[part] if changed[part][key] != plain[part][key]]
        assert len(keys) == 1 or network == "videonet"
    thesis = yaml.safe_load(preset_texts()[f"{network}_thesis"])
    known = (NetworkConfig if network == "flatnet3d" else VideoNetworkConfig)(**thesis["network"])
    assert made["thesis"][0].network.numbers == known.numbers
    for name in ("inversion_rate", "freeze_statistics"):
        assert getattr(made["thesis"][0].optimiser, name) == thesis["optimiser"][name]


def test_classifiers_are_evaluated_where_they_are_trained_on_data_that_are_made(tmp_path: Path) -> None:
    """What bash would call at the head of the evaluation makes all of its folders, each as its row says."""
    for name in ("activity_64", "activitynet_64"):
        text = preset_text(name) if name in preset_names() else preset_texts()[name]
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    calls = _called_at_the_head("evaluate_activity_64", tmp_path)
    made = {
        config.dataset.output: config
        for command, path, *given in calls
        if command == "generate" and (config := load_config(tmp_path / path, given[1::2]))
    }
    trained: dict[str, Any] = {
        training.output: training
        for command, path, *given in calls
        if command == "train" and (training := load_file(training_kind, tmp_path / path, given[1::2]))
    }
    config = load_file(evaluation_kind, _written("evaluate_activity_64", tmp_path))
    assert isinstance(config, RecognitionConfig)
    data = {config.data.test, config.data.backwards, *(one.test for one in config.classifiers)} - {None}
    assert data <= made.keys()
    assert all(made[folder].dataset.test >= 600 for folder in data)
    rows = {
        one.name: [trained[path.removesuffix("/best.safetensors")] for path in one.checkpoints]
        for one in config.classifiers
    }
    assert {training.data.train for row in rows.values() for training in row} <= made.keys()
    for name, row in rows.items():
        assert [training.seed for training in row] == list(range(len(row)))
        slivers = re.search(r"(\d+) slivers?$", name)
        assert row[0].data.slivers == (int(slivers[1]) if slivers else 20 if name == "one sharp frame" else None)
    assert config.ceiling == "lens video"
    looks = {"lens video": "all", "lens video in random order": "shuffled"}
    looks |= {"one sharp frame": "middle", "background only": "middle"}
    classifiers = {"ActivityNet, ResNet-18": "resnet18", "ActivityNet, 3D network": "cnn3d", "ActivityNet, X3D": "x3d"}
    for name, row in rows.items():
        for one in row:
            kind = "lens_classifier" if name in looks else "raw_classifier" if name == "raw capture" else "activitynet"
            assert one.network.name == kind, name
            assert getattr(one.network, "frames", None) == looks.get(name), name
            assert one.network.classifier == classifiers.get(name, "dronet"), name
            assert one.data.shuffle_labels == (name == "ActivityNet, shuffled labels"), name
            other = {"background only": "out/activity_64_background", "global shutter": "out/activity_64_global"}
            assert one.data.train == other.get(name, "out/activity_64"), name
    assert made["out/activity_64"] == load_config(tmp_path / "activity_64.yaml"), "which docs/activity.md makes, too"
    assert made["out/activity_64_global"].camera.shutter.type == "global"
    assert made["out/activity_64_background"].scene.only_background


def _called_at_the_head(preset: str, tmp_path: Path) -> list[list[str]]:
    """Return the arguments of each call of `flatlight` with which a preset's first lines make data and train."""
    head = preset_texts()[preset].partition("\n# Evaluate:")[0]
    lines = [re.sub(r"^#(?: [A-Z][a-z ]+:)? +", "", line) for line in head.splitlines()[1:]]
    told = 'flatlight() { printf "%s\\n" "$@"; echo --; }'
    ran = subprocess.run(
        ["bash", "-ec", "\n".join([told, *lines])], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    return [call.splitlines() for call in ran.stdout.split("--\n")[:-1]]
