"""The galleries say what designs and scene families say of themselves; the site's family and SLURM's script work."""

import os
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from psf_library import load_mask
from simulator.plugins import available, import_file, resolve

TOP = Path(__file__).resolve().parents[2]
DOCS = TOP / "docs"
# Largest number of bytes, least and greatest width of an image.
IMAGES = {"designs": (150_000, 720, 720), "scenes": (250_000, 800, 1500)}


@pytest.fixture(scope="module")
def galleries() -> ModuleType:
    """The script that makes the galleries."""
    return import_file(DOCS / "galleries.py", "docs_galleries")


@pytest.mark.parametrize("name", IMAGES)
def test_every_plugin_is_shown(galleries, name: str) -> None:
    gallery = galleries.GALLERIES[name]
    assert set(gallery.examples) == set(available(gallery.kind))
    most_bytes, least, greatest = IMAGES[name]
    for shown in gallery.examples:
        path = DOCS / "images" / name / f"{shown}{gallery.suffix}"
        assert path.stat().st_size < most_bytes, shown
        with Image.open(path) as image:
            assert least <= image.width <= greatest
            assert np.ptp(np.asarray(image.convert("L"))) > 200


@pytest.mark.parametrize("name", IMAGES)
def test_the_lists_of_parameters_are_the_plugins_own(galleries, name: str) -> None:
    """Fails when a plugin's parameters changed since: run docs/pictures.py NAME --text, or let it draw them anew."""
    assert (DOCS / f"{name}.md").read_text(encoding="utf-8") == galleries.GALLERIES[name].text(name)


def test_the_designs_take_their_examples_parameters_and_files(galleries, tmp_path: Path) -> None:
    for design, shown in galleries.DESIGNS.items():
        resolve("mask", design).bind(shown.parameters)
        if shown.files is not galleries.no_files:
            shown.files(tmp_path)
            assert load_mask(design, tmp_path, **shown.parameters).shape == (300, 300)


def test_the_families_take_their_examples_parameters_files_and_view(galleries, tmp_path: Path) -> None:
    from simulator.render import Renderer

    for family, shown in galleries.FAMILIES.items():
        folder = tmp_path / family
        folder.mkdir()
        shown.files(folder)
        plugin = resolve("scene", family, folder)
        view = galleries.view_of(shown, folder)
        assert view.shape == (galleries.SIDE, galleries.SIDE)
        plugin.function(view, **plugin.bind(shown.parameters), renderer=Renderer("scalar_rgb"))


def test_the_family_of_the_examples_takes_the_default_file_s_keys_and_gives_a_good_image(tmp_path: Path) -> None:
    """Stripes and shading on a wall that is neither black nor white; without the margin, the image alone is rendered."""
    from simulator.assembly import Assembly
    from simulator.config import load_config

    shutil.copy(DOCS / "examples" / "my_scenes.py", tmp_path)
    shutil.copy(TOP / "sim_config.yaml", tmp_path)
    config = load_config(tmp_path / "sim_config.yaml", ["scene.family=./my_scenes.py:marbles", "scene.margin=0"])
    clip = Assembly(config, backend="scalar_rgb").source.clip(0, np.random.default_rng(1))
    assert clip.rgb.shape == (1, *config.scene.size, 3)
    assert clip.source["samples_per_pixel"] == config.scene.params["samples_per_pixel"]
    assert clip.valid.all()
    grey = clip.rgb[0].mean(axis=-1)
    middle = np.median(grey)
    assert np.mean(grey > 5 * middle) < 0.01  # hardly anything is burnt out
    assert np.mean(np.abs(grey / middle - 1) > 0.3) > 0.2  # and much is not of one brightness
    marble = clip.depth_m[0] < 0.9 * clip.depth_m.max()
    assert 0.1 < marble.mean() < 0.6
    assert clip.depth_m[0][marble].std() > 0.01


def test_the_light_path_of_the_readme_is_that_of_the_example() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (TOP / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    example = (DOCS / "examples" / "light_path.py").read_text(encoding="utf-8").splitlines()
    assert [line for line in block.splitlines() if line not in example] == []


def test_slurm_s_array_has_a_task_for_every_shard(tmp_path: Path) -> None:
    """The script starts what is called flatlight: here, one that says what it was given."""
    (tmp_path / "flatlight").write_text('#!/bin/sh\necho "$@"\n')
    (tmp_path / "flatlight").chmod(0o755)
    script = DOCS / "slurm.sh"
    (last,) = re.findall(r"^#SBATCH --array=0-(\d+)$", script.read_text(encoding="utf-8"), re.MULTILINE)
    job = {"SLURM_ARRAY_TASK_ID": last, "SLURM_CPUS_PER_TASK": "8", "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    command = ["bash", str(script), "my.yaml", "--skip-bad"]
    done = subprocess.run(command, env=os.environ | job, capture_output=True, text=True, check=True)
    shard = f"{last}/{int(last) + 1}"
    assert done.stdout == f"generate my.yaml --skip-bad --shard {shard} --set dataset.workers=8\n"
