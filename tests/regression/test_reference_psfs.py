"""The pinned PSFs of every design: a release changes none of them unless somebody says so with ``--regen-psf``.

A failure names design, depth, channel and pixel, and draws expected | found | difference into the test's output folder.
What is pinned is our own output, so this says that something changed, never that it is right: tests/physics says that.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from psf_library import reference
from psf_library.reference import CASES, build_mask, compare_stacks, compute, draw_difference, load, load_pinned_mask
from psf_library.reference.cases import PINNED, write
from psf_library.reference.make import CHANGED_SAMPLES, PSF_TOLERANCE, changed_samples, remake
from simulator.errors import InputError
from simulator.plugins import available

CURE = "pytest --regen-psf tests/regression accepts it, if it is meant"


@pytest.fixture
def folder(request: pytest.FixtureRequest) -> Path:
    """The folder of the references; with ``--regen-psf`` the test's own is brought up to date first."""
    return request.config.getoption("--psf-references") or PINNED


@pytest.fixture(params=CASES)
def name(request: pytest.FixtureRequest, folder: Path) -> str:
    if request.config.getoption("--regen-psf"):
        change = remake(request.param, folder)
        if change.rewritten:
            pytest.skip(f"rewritten: {change.note}")
    return request.param


def test_the_design_makes_the_pinned_mask(name: str, folder: Path) -> None:
    mask, pinned = build_mask(name), load_pinned_mask(name, folder)
    changed = changed_samples(mask, pinned)
    if changed > CHANGED_SAMPLES:
        message = (
            f"{name}: {changed:.2%} of the mask's samples are not the pinned ones ({mask.shape} of {mask.pitch_m:g} m, "
            f"pinned {pinned.shape}), at most {CHANGED_SAMPLES:.2%} may flip; {CURE}"
        )
        pytest.fail(message, pytrace=False)


def test_the_pinned_mask_casts_the_pinned_psf(name: str, folder: Path, tmp_path: Path) -> None:
    expected = load(name, folder)
    found = compute(name, load_pinned_mask(name, folder))
    try:
        difference = compare_stacks(found, expected)
    except InputError as error:
        pytest.fail(f"{name}: {error}; {CURE}", pytrace=False)
    if difference.error > PSF_TOLERANCE:
        picture = draw_difference(found, expected, tmp_path / f"{name}.png")
        message = f"{name} changed by more than {PSF_TOLERANCE:g}\n{difference}\nlook at {picture}\n{CURE}"
        pytest.fail(message, pytrace=False)


def test_every_shipped_design_is_pinned_and_nothing_else() -> None:
    ours = [
        design
        for design in available("mask")
        if (Path(reference.__file__).parents[1] / f"designs/{design}.py").exists()
    ]
    assert sorted(CASES) == sorted(ours), "give each design one entry in psf_library/reference/cases.py"
    assert sorted(path.name for path in PINNED.iterdir()) == sorted(CASES), "python -m psf_library.reference.make"


def test_the_references_stay_small() -> None:
    assert sum(path.stat().st_size for path in PINNED.rglob("*") if path.is_file()) < 1.5e6


SUBJECT = "mura"  # of the tests of the mechanism: its PSFs cost the least


class TestTheTestItself:
    """A reference that no longer fits fails with the place and the picture, and is accepted on request."""

    @pytest.fixture
    def bent(self, tmp_path: Path) -> Path:
        """A copy of one reference in which a pixel of the far blue plane is 1 % of the plane's maximum too bright."""
        folder = tmp_path / "references"
        shutil.copytree(PINNED / SUBJECT, folder / SUBJECT)
        stack = load(SUBJECT, folder)
        values = np.array(stack.values)
        values[1, 2, 11, 13] += 0.01 * values[1, 2].max()
        write(SUBJECT, load_pinned_mask(SUBJECT, folder), replace(stack, values=values), folder)
        return folder

    @pytest.mark.slow
    def test_a_change_is_accepted_on_request(self, bent: Path) -> None:
        """In a process of its own, because the option belongs to a whole run."""
        root = Path(__file__).parents[2]
        words = [
            sys.executable,
            *["-m", "pytest", "-n0", "-p", "no:cacheprovider", "-k"],
            f"casts and {SUBJECT}",
            __file__,
        ]
        options = ["--psf-references", str(bent), "--basetemp", str(bent.parent / "pytest"), "--regen-psf"]
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
        done = subprocess.run(
            [*words, *options], capture_output=True, text=True, timeout=120, check=False, cwd=root, env=environment
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert f"rewritten: {SUBJECT}: 0.00% of the mask's samples changed, PSF relative L2 0.0" in done.stdout
        assert "1 skipped" in done.stdout
        assert compare_stacks(load(SUBJECT, bent), load(SUBJECT)).error < PSF_TOLERANCE


def test_remaking_leaves_alone_what_is_still_right(tmp_path: Path) -> None:
    shutil.copytree(PINNED / SUBJECT, tmp_path / SUBJECT)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert not remake(SUBJECT, tmp_path).rewritten
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_remaking_follows_a_changed_mask(tmp_path: Path) -> None:
    """The pinned mask has lost a row: both it and the PSFs are made anew from the design."""
    shutil.copytree(PINNED / SUBJECT, tmp_path / SUBJECT)
    mask = load_pinned_mask(SUBJECT, tmp_path)
    amplitude = np.array(mask.amplitude)
    lost = np.count_nonzero(amplitude[20])
    amplitude[20] = 0
    write(SUBJECT, replace(mask, amplitude=amplitude), load(SUBJECT, tmp_path), tmp_path)
    change = remake(SUBJECT, tmp_path)
    assert change.rewritten
    assert f"{lost / amplitude.size:.2%} of the mask's samples changed" in change.note
    assert changed_samples(load_pinned_mask(SUBJECT, tmp_path), build_mask(SUBJECT)) == 0


def test_another_pitch_is_another_mask() -> None:
    mask = build_mask(SUBJECT)
    assert changed_samples(mask, replace(mask, pitch_m=1.01 * mask.pitch_m)) == 1


def test_remaking_writes_what_is_missing(tmp_path: Path) -> None:
    assert "new, because" in remake(SUBJECT, tmp_path).note
    assert compare_stacks(load(SUBJECT, tmp_path), load(SUBJECT)).error < PSF_TOLERANCE
