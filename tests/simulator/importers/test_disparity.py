"""PFM files against OpenCV's reader, and every way of being broken."""

import cv2
import numpy as np
import pytest

from simulator.errors import InputError
from simulator.importers.disparity import read_pfm
from simulator.io.images import read_image


def write_pfm(path, values, scale=-1.0):
    """Row 0 of ``values`` is the top; the sign of the scale chooses the byte order."""
    magic = "PF" if values.ndim == 3 else "Pf"
    header = f"{magic}\n{values.shape[1]} {values.shape[0]}\n{scale}\n".encode()
    path.write_bytes(header + values[::-1].astype("<f4" if scale < 0 else ">f4").tobytes())


@pytest.mark.parametrize("scale", [-1.0, 1.0])
@pytest.mark.parametrize("channels", [None, 3])
def test_agrees_with_opencv_in_both_byte_orders(tmp_path, scale, channels):
    shape = (4, 7) if channels is None else (4, 7, channels)
    original = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    path = tmp_path / "a.pfm"
    write_pfm(path, original, scale)
    found = read_pfm(path)
    theirs = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert theirs is not None
    assert found.dtype == np.float32
    assert found.flags.c_contiguous
    assert np.array_equal(found, original)
    assert np.array_equal(found, theirs if channels is None else theirs[..., ::-1])  # OpenCV has BGR
    assert cv2.imwrite(str(path), theirs)
    assert np.array_equal(read_pfm(path), original)


@pytest.mark.shared
def test_the_real_sample_has_the_noted_range_and_is_upright(shared_data):
    root = shared_data / "flyingthings3d/SCENE_FLOW"
    disparity = read_pfm(root / "disparity/left/A-0032-0006.pfm")
    assert disparity.shape == (540, 960)
    assert disparity.min() == pytest.approx(1.206, abs=5e-4)  # the note's digits
    assert disparity.max() == pytest.approx(130.365, abs=5e-4)
    # The right picture, fetched at x - d, must be the left one where nothing hides it.
    left, right, hidden = (
        read_image(root / f"{folder}/A-0032-0006.png").astype(float)
        for folder in ("RGB_cleanpass/left", "RGB_cleanpass/right", "occlusion/left")
    )
    columns = np.rint(np.arange(960) - disparity).astype(int)
    seen = (hidden == 0) & (columns >= 0)
    fetched = right[np.arange(540)[:, None], np.maximum(columns, 0)]
    assert np.abs(fetched - left).mean(-1)[seen].mean() < 2.5  # of 255; upside down it is above 16


@pytest.mark.parametrize(
    "header",
    [
        *(b"P5\n7 4\n-1.0\n", b"", b"Pf\n7\n", b"Pf\nseven 4\n-1.0\n"),
        *(b"Pf\n7 4\n%b\n" % scale for scale in (b"small", b"0.0", b"nan", b"-inf")),
        *(b"Pf\n%b\n-1.0\n" % size for size in (b"-7 4", b"0 4", b"9999999999 9999999999", b"8 4", b"6 4")),
        b"PF\n7 4\n-1.0\n",
    ],
)
def test_bad_headers_and_lengths_are_named(tmp_path, header):
    path = tmp_path / "bad.pfm"
    path.write_bytes(header + (bytes(112) if header else b""))
    with pytest.raises(InputError, match=r"bad\.pfm: "):
        read_pfm(path)


def test_unknown_values_of_middlebury_are_kept(tmp_path):
    """Its files hold inf where nothing is known, and a scale other than 1, which is a display hint."""
    values = np.arange(28, dtype=np.float32).reshape(4, 7)
    values[2, 3], values[0, 0] = np.inf, np.nan
    write_pfm(tmp_path / "disp0.pfm", values, -0.003922)
    np.testing.assert_array_equal(read_pfm(tmp_path / "disp0.pfm"), values)


def test_missing_files_are_refused(tmp_path):
    for path in (tmp_path / "none.pfm", tmp_path):
        with pytest.raises(InputError, match=f"^{path}: "):
            read_pfm(path)
