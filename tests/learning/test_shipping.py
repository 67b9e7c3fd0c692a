"""Checkpoints to be given away: half the size, the same pictures, no paths."""

from dataclasses import replace

import pytest
import torch

from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.models import build_network
from learning.shipping import ship_checkpoint, without_paths
from simulator.errors import InputError

RECORD = {
    "command": "flatlight train a.yaml --set output=/tmp/runs/s0 --set data.workers=0 --set data.cache='/tmp/c d'",
    "config": {"output": "/tmp/runs/s0", "data": {"train": "/data/ft64/", "noise_db": [20.0, 50.0], "cache": None}},
    "loss": {"depth": "l1 of disparity 0..1, valid pixels"},
}


@pytest.fixture
def source(tmp_path, tiny_capture):
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "compact", levels=4)
    network(torch.rand(4, 3, 48, 48))  # moves the running means
    stack = replace(tiny_capture.stack, provenance={"folder": "/home/anna/psf", "source": "https://a.org/b (1 / m)"})
    path = tmp_path / "best.safetensors"
    save_checkpoint(
        path,
        network,
        architecture={"network": "flatnet3d", "size": "compact", "levels": 4},
        capture=tiny_capture.with_stack(stack),
        record=RECORD,
    )
    return path


def test_is_half_the_size_and_nearly_the_same_network(source, tmp_path):
    target = tmp_path / "small.safetensors"
    before = source.read_bytes()
    ship_checkpoint(source, target)
    assert source.read_bytes() == before
    assert target.stat().st_size < 0.6 * source.stat().st_size
    own, shipped = load_checkpoint(source), load_checkpoint(target)
    assert shipped.architecture == own.architecture
    assert shipped.fingerprint == own.fingerprint
    measurement = torch.rand(2, 3, 48, 48)
    with torch.no_grad():
        wanted, got = own.network(measurement), shipped.network(measurement)
    # Filters rounded by up to 2^-11 each; errors add up as roots over a dozen layers.
    torch.testing.assert_close(got, wanted, rtol=0, atol=5e-3)
    assert not torch.equal(got.picture, wanted.picture)


def test_keeps_the_record_but_for_paths(source, tmp_path):
    target = tmp_path / "small.safetensors"
    ship_checkpoint(source, target)
    shipped = load_checkpoint(target)
    record = shipped.record
    assert record["config"] == {"output": "s0", "data": {"train": "ft64", "noise_db": [20.0, 50.0], "cache": None}}
    assert record["command"].startswith("flatlight train a.yaml --set output=s0 --set data.workers=0 --set data.cache=")
    assert record["loss"] == RECORD["loss"]
    assert record["shipped"]["filters and PSFs"] == "float16"
    assert shipped.capture.stack.provenance == {"folder": "psf", "source": "https://a.org/b (1 / m)"}
    for text in (b"/tmp", b"/home", b"anna", b"/data"):
        assert text not in target.read_bytes()


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("C:\\runs\\a", "a"),
        ("~/runs/a/", "a"),
        ("see /a/b/c, then (/d/e)", "see c, then (e)"),
        ("W/m, 1 / s and/or runs/a", "W/m, 1 / s and/or runs/a"),
        ("http://a.org/b", "http://a.org/b"),
    ],
)
def test_only_absolute_paths_are_shortened(text, left):
    assert without_paths({"x": [text, 3, None]}) == {"x": [left, 3, None]}


def test_refuses_what_is_no_checkpoint(tmp_path):
    other = tmp_path / "x.safetensors"
    other.write_bytes(b"nothing")
    with pytest.raises(InputError, match="is no checkpoint"):
        ship_checkpoint(other, tmp_path / "y.safetensors")
    assert not (tmp_path / "y.safetensors").exists()
