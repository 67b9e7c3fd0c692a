"""Names that would lead an export elsewhere; for what is in a data set see the test of that name one folder up."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.dataset.exports import FORMATS, export
from simulator.errors import InputError


def test_a_link_in_the_folder_to_write_to(dataset: Path, tmp_path: Path) -> None:
    export(dataset, "webdataset", tmp_path / "out")
    outside = tmp_path / "outside"
    (tmp_path / "out/psf").rename(outside)
    (tmp_path / "out/psf").symlink_to(outside)
    with pytest.raises(InputError, match=r"--output: .*psf is a link"):
        export(dataset, "webdataset", tmp_path / "out")


def test_an_extra_whose_name_leads_out(samples: ModuleType, tmp_path: Path) -> None:
    extras = {"../../x": np.zeros((1, *samples.SCENE), np.float32)}
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, extras=extras))
    for to in ("hdf5", "npz"):
        with pytest.raises(InputError, match=r"extras\['\.\./\.\./x'\]"):
            export(root, to, tmp_path / to)
    assert export(root, "webdataset", tmp_path / "webdataset").samples == 4


def test_names_and_labels_of_any_text(samples: ModuleType, tmp_path: Path) -> None:
    """They are content, never names of files."""
    text = "../../x\n\0</script>'; DROP TABLE"
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, label=text), name=text)
    for to in FORMATS:
        assert export(root, to, tmp_path / to).samples == 4
    assert {path.name for path in tmp_path.iterdir()} == {"set", *FORMATS}
