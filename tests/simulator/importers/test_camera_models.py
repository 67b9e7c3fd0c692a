"""Camera models against OpenCV and against MATLAB's equations written out."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.importers.camera_models import (
    OpencvFisheye,
    Pinhole,
    Scaramuzza,
    pinhole_of,
    read_calibration,
    read_intrinsics,
)

# EndoSLAM's own calibrations, MATLAB's numbers (first pixel 1).
MIRO_PINHOLE = Pinhole(
    fx=159.59060167, fy=159.22405216, cx=161.92969024, cy=163.16857089, distortion=(-0.23212007, 0.03774762),
    first_pixel=1,
)  # fmt: skip
MIRO_FISHEYE = Scaramuzza(
    mapping=(135.999364, -5.68730971e-3, 5.81750636e-5, -2.27853502e-7), cx=163.24233245,
    cy=161.53438158, first_pixel=1,
)  # fmt: skip
PILL_FISHEYE = Scaramuzza(
    mapping=(71.0290892, 7.41388637e-3, -9.21512669e-5, 1.34438894e-7), cx=130.48390042,
    cy=129.77308391, first_pixel=1, stretch=((1.01, 0.004), (-0.003, 1.0)),
)  # fmt: skip


def rays(half, count=15):
    return np.meshgrid(np.linspace(-half, half, count), np.linspace(-half, half, count))


@pytest.mark.parametrize("distortion", [(), (-0.3, 0.1), (-0.2, 0.05, 0.002, -0.003), (0.2, -0.1, 1e-3, 2e-3, 0.02)])
def test_pinhole_is_opencvs(distortion):
    cv2 = pytest.importorskip("cv2")
    lens = Pinhole(fx=160.0, fy=150.0, cx=161.9, cy=163.2, distortion=distortion)
    x, y = rays(0.6)
    matrix = np.array([[160.0, 0, 161.9], [0, 150.0, 163.2], [0, 0, 1]])
    points = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array([*distortion, *[0.0] * 5][:5]))
    found = np.stack(lens.pixels(x, y), -1).reshape(-1, 2)
    np.testing.assert_allclose(found, expected[:, 0], rtol=0, atol=1e-10)


def test_opencv_fisheye_is_opencvs():
    cv2 = pytest.importorskip("cv2")
    k = (-0.05, 0.02, -0.003, 0.0005)
    lens = OpencvFisheye(fx=120.0, fy=118.0, cx=159.5, cy=161.0, distortion=k)
    x, y = rays(2.0)  # up to 70 degrees from the axis
    matrix = np.array([[120.0, 0, 159.5], [0, 118.0, 161.0], [0, 0, 1]])
    points = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 1, 3)
    expected, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(k))
    found = np.stack(lens.pixels(x, y), -1).reshape(-1, 2)
    np.testing.assert_allclose(found, expected[:, 0], rtol=0, atol=1e-10)


@pytest.mark.parametrize("lens", [MIRO_FISHEYE, PILL_FISHEYE])
def test_scaramuzza_inverts_matlabs_equation(lens):
    """A pixel's ray is (u, v, a0 + a2 r^2 + a3 r^3 + a4 r^4) with (column, row) = S (u, v) + centre."""
    a0, a2, a3, a4 = lens.mapping
    u, v = rays(80.0, 21)
    r = np.hypot(u, v)
    z = a0 + a2 * r**2 + a3 * r**3 + a4 * r**4
    seen = z > 0
    columns, rows = np.einsum("ij,j...->i...", np.array(lens.stretch), np.stack([u, v]))
    found = lens.pixels(u[seen] / z[seen], v[seen] / z[seen])
    # MATLAB's centre counts pixels from 1, ours from 0.
    np.testing.assert_allclose(found[0], columns[seen] + lens.cx - 1, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found[1], rows[seen] + lens.cy - 1, rtol=0, atol=1e-8)
    assert seen.mean() > 0.9


def test_rays_beyond_the_turning_point_are_not_seen():
    """The map r (1 - r^2 / 3) rises to r = 1 and then folds back into the picture."""
    columns, _ = Pinhole(fx=100.0, fy=100.0, cx=0.0, cy=0.0, distortion=(-1 / 3, 0.0)).pixels(
        np.array([0.0, 0.999, 1.001, 1.5]), np.zeros(4)
    )
    assert np.isnan(columns).tolist() == [False, False, True, True]


def test_a_camera_matrix():
    rows = np.array([[156.0, 0, 178.5], [0, 155.7, 181.8], [0, 0, 1]])
    assert pinhole_of(rows, "cam.txt") == Pinhole(fx=156.0, fy=155.7, cx=178.5, cy=181.8)
    with pytest.raises(InputError, match=r"^cam\.txt: "):
        pinhole_of(rows.T, "cam.txt")
    with pytest.raises(InputError, match=r"^cam\.txt: "):
        pinhole_of(rows - 1, "cam.txt")


def test_files(tmp_path):
    for name, text in {
        "camera_intrinsics.txt": "20,0,7.5,0,20,7.5,0,0,1",
        "cam.txt": "20 0 7.5\n0 20 7.5\n0 0 1\n",
        "intrinsics.txt": "20 20 7.5 7.5",
        "intrinsic_color.txt": "20 0 7.5 0\n0 20 7.5 0\n0 0 1 0\n0 0 0 1\n",  # as ScanNet writes it
        "camera.yaml": "type: pinhole\nfx: 20\nfy: 20\ncx: 8.5\ncy: 8.5\nfirst_pixel: 1\n",
    }.items():
        (tmp_path / name).write_text(text)
        lens = read_intrinsics(tmp_path / name)
        assert (*lens.centre, *lens.pixels(np.ones(1), np.ones(1))) == (7.5, 7.5, 27.5, 27.5)
    for name, text in [
        ("cam.txt", "20 0 7.5"),
        ("camera.yaml", "model: ["),
        ("camera.yaml", "{type: pinhole, fx: 20, fy: 20, cx: 7}"),
        ("camera.yaml", "3"),
    ]:
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=f"{name}: "):
            read_intrinsics(tmp_path / name)
    with pytest.raises(InputError, match=r"nowhere\.txt: "):
        read_intrinsics(tmp_path / "nowhere.txt")


def test_middlebury_s_calib_txt(tmp_path):
    """The file of its scene Adirondack-perfect, with numbers of its documentation."""
    path = tmp_path / "calib.txt"
    lines = [
        "cam0=[3997.684 0 1176.728; 0 3997.684 1011.728; 0 0 1]",
        "cam1=[3997.684 0 1307.839; 0 3997.684 1011.728; 0 0 1]",
    ]
    lines += [
        "doffs=131.111",
        "baseline=193.001",
        "width=2964",
        "height=1988",
        "ndisp=280",
        "isint=0",
        "vmin=31",
        "vmax=257",
    ]
    path.write_text("\n".join(lines))
    found = read_calibration(path)
    assert found.lens == Pinhole(fx=3997.684, fy=3997.684, cx=1176.728, cy=1011.728)
    assert (found.baseline_mm, found.doffs_px) == (193.001, 131.111)
    assert read_calibration(path, second=True).lens.cx == 1307.839
    for line, broken in [(3, "baseline="), (3, ""), (2, "doffs=far"), (0, "cam0=[3997.684 0 1176.728]")]:
        path.write_text("\n".join([*lines[:line], broken, *lines[line + 1 :]]))
        with pytest.raises(InputError, match=r"calib\.txt: "):
            read_calibration(path)
