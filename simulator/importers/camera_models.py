"""Lenses of data sets' cameras: from a ray to the pixel that sees it, for pinholes with distortion and for fisheyes.

Sources: Brown, Close-range camera calibration, 1971, as OpenCV and MATLAB write it (pinhole); Kannala and Brandt, A
generic camera model and calibration method, TPAMI 2006, as ``cv2.fisheye`` writes it; Scaramuzza, Martinelli and
Siegwart, A toolbox for easily calibrating omnidirectional cameras, IROS 2006, as MATLAB's ``fisheyeIntrinsics`` writes it.

The camera of a data set comes from the configuration or from a file beside the images.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, RootModel, ValidationError

from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.validation import find_problems, validate

Positive: TypeAlias = Annotated[float, Field(gt=0)]
Pixels: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
_STEPS = 4096


class _Lens(BaseModel, frozen=True):
    """What all models share.

    Attributes:
        cx: column of the optical axis.
        cy: row of the optical axis.
        first_pixel: coordinate of the centre of the first pixel: 0 as in OpenCV, 1 as in MATLAB.
    """

    model_config = ConfigDict(strict=True, extra="forbid")

    cx: float
    cy: float
    first_pixel: Literal[0, 1] = 0

    def pixels(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pixels:
        """Return where rays (x, y, 1) arrive.

        Args:
            x: tangents to the right, any shape.
            y: tangents downwards, same shape.

        Returns:
            Columns and rows, whole numbers at pixel centres, the first pixel 0; NaN where the model sees no such ray.
        """
        columns, rows = self._project(x, y)
        return columns - self.first_pixel, rows - self.first_pixel

    @property
    def centre(self) -> tuple[float, float]:
        """Column and row of the optical axis, the first pixel being 0."""
        return self.cx - self.first_pixel, self.cy - self.first_pixel

    @abstractmethod
    def _project(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pixels:
        """Return columns and rows as the calibration counts them, NaN where the model sees no such ray."""


class Pinhole(_Lens, frozen=True):
    """A pinhole with radial and tangential distortion.

    Attributes:
        fx: focal length in pixels, across.
        fy: focal length in pixels, downwards.
        distortion: k1, k2, p1, p2, k3 in OpenCV's order; none, two, four or five.
    """

    type: Literal["pinhole"] = "pinhole"
    fx: Positive
    fy: Positive
    distortion: (
        tuple[()] | tuple[float, float] | tuple[float, float, float, float] | tuple[float, float, float, float, float]
    ) = ()

    def _project(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pixels:
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * 5)[:5]
        square = x**2 + y**2
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        # Beyond the radius at which r -> r (1 + k1 r^2 + ...) turns back, the polynomial describes no lens any more.
        square = np.where(square < _turning_point(k1, k2, k3), square, np.nan)
        bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2)
        bent_y = y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y
        return self.fx * bent_x + self.cx, self.fy * bent_y + self.cy


class OpencvFisheye(_Lens, frozen=True):
    """``cv2.fisheye``: the distance from the axis is theta (1 + k1 theta^2 + ... + k4 theta^8) focal lengths.

    Attributes:
        fx: focal length in pixels, across.
        fy: focal length in pixels, downwards.
        distortion: k1 to k4.
    """

    type: Literal["opencv_fisheye"] = "opencv_fisheye"
    fx: Positive
    fy: Positive
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def _project(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pixels:
        tangent = np.hypot(x, y)
        theta = np.arctan(tangent)
        square = theta**2
        powers = np.polynomial.polynomial.polyval(square, [1.0, *self.distortion])
        grid = np.linspace(0, np.pi / 2, _STEPS)
        bent = grid * np.polynomial.polynomial.polyval(grid**2, [1.0, *self.distortion])
        powers = np.where(theta < grid[_rising(bent) - 1], powers, np.nan)
        ratio = np.divide(theta * powers, tangent, out=np.ones_like(tangent), where=tangent > 0)
        return self.fx * x * ratio + self.cx, self.fy * y * ratio + self.cy


class Scaramuzza(_Lens, frozen=True):
    """MATLAB's ``fisheyeIntrinsics``: the pixel at (u, v) from the centre sees the ray (u, v, a0 + a2 r^2 + a3 r^3 + a4 r^4).

    Attributes:
        mapping: a0, a2, a3, a4 (``MappingCoefficients``); a0 in pixels.
        stretch: rows of the matrix that takes (u, v) to the sensor's pixels (``StretchMatrix``).
    """

    type: Literal["scaramuzza"] = "scaramuzza"
    mapping: tuple[Positive, float, float, float]
    stretch: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))

    def _project(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> Pixels:
        a0, a2, a3, a4 = self.mapping
        polynomial = np.polynomial.Polynomial([a0, 0.0, a2, a3, a4])
        # cot(theta) = f(r) / r falls with r as long as the lens is one; beyond that no ray is seen.
        grid = np.linspace(0, 20 * a0, _STEPS)
        tangent = np.hypot(x, y)
        with np.errstate(divide="ignore"):
            theta = np.arctan2(grid, polynomial(grid))
        last = _rising(theta)
        radius = np.interp(np.arctan(tangent), theta[:last], grid[:last], right=np.nan)
        slope = polynomial.deriv()
        for _ in range(4):  # Newton on f(r) tan(theta) - r, from a guess that is right to a fraction of a grid step
            radius = radius - (polynomial(radius) * tangent - radius) / (slope(radius) * tangent - 1)
        share = np.divide(radius, tangent, out=np.full_like(tangent, a0), where=tangent > 0)
        u, v = x * share, y * share
        (c, d), (e, f) = self.stretch
        return c * u + d * v + self.cx, e * u + f * v + self.cy


Lens: TypeAlias = Pinhole | OpencvFisheye | Scaramuzza


def pinhole_of(matrix: NDArray[np.float64], name: str) -> Pinhole:
    """Return the pinhole of a camera matrix ``(3, 3)``: fx, 0, cx; 0, fy, cy; 0, 0, 1.

    Raises:
        InputError: when it is not such a matrix, or is MATLAB's transposed one.
    """
    numbers = matrix.tolist()
    if matrix[2, 0] > 0 and matrix[2, 1] > 0 and not matrix[0, 2] and not matrix[1, 2]:
        raise InputError(
            name,
            f"holds MATLAB's transposed camera matrix {numbers}: write it as intrinsics: {{type: pinhole, "
            f"fx: {matrix[0, 0]:g}, fy: {matrix[1, 1]:g}, cx: {matrix[2, 0]:g}, cy: {matrix[2, 1]:g}, first_pixel: 1}}",
        )
    (fx, skew, cx), (zero, fy, cy), last = numbers
    if not np.all(np.isfinite(matrix)) or fx <= 0 or fy <= 0 or skew or zero or last != [0.0, 0.0, 1.0]:
        raise InputError(name, f"holds {numbers}; expected the camera matrix fx, 0, cx, 0, fy, cy, 0, 0, 1 row by row")
    return Pinhole(fx=fx, fy=fy, cx=cx, cy=cy)


def _turning_point(k1: float, k2: float, k3: float) -> float:
    """Square of the smallest radius at which r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops to rise; inf where it never does."""
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    real = roots[np.isreal(roots)].real
    return float(min(real[real > 0], default=np.inf))


def _rising(values: NDArray[np.float64]) -> int:
    """How many of the first values rise strictly."""
    falls = np.flatnonzero(np.diff(values) <= 0)
    return int(falls[0]) + 1 if falls.size else len(values)


Intrinsics = Annotated[Pinhole | OpencvFisheye | Scaramuzza, Field(discriminator="type")]
_MAX_BYTES = 65536
FILE_NAMES = ("camera_intrinsics.txt", "cam.txt", "calib.txt", "intrinsics.txt", "intrinsic.txt")


class _File(RootModel[Intrinsics]):
    """A file that holds what ``intrinsics`` would."""


@dataclass(frozen=True)
class Calibration:
    """What a file says of a camera.

    Attributes:
        lens: of the camera.
        baseline_mm: distance to the second camera of a rectified stereo pair, or None.
        doffs_px: column of the second camera's principal point minus that of the first.
    """

    lens: Lens
    baseline_mm: float | None = None
    doffs_px: float = 0.0


def read_intrinsics(path: Path) -> Lens:
    """Read a camera's lens from a file; see :func:`read_calibration`."""
    return read_calibration(path).lens


def read_calibration(path: Path, second: bool = False) -> Calibration:
    """Read a camera from a file.

    Args:
        path: ``.yaml``, ``.yml`` or ``.json`` with the keys of ``intrinsics``; or Middlebury's ``calib.txt``, lines such as
            ``cam0=[f 0 cx; 0 f cy; 0 0 1]``, ``doffs=131.111`` and ``baseline=193.001`` in mm; anything else is text with the
            nine numbers of the camera matrix row by row, parted by commas or blanks (EndoSLAM's ``camera_intrinsics.txt``,
            SimCol3D's ``cam.txt``), the sixteen of a projection of the same, or fx, fy, cx, cy.
        second: take the second camera of a pair, Middlebury's cam1.

    Raises:
        InputError: naming the file, when it cannot be read or describes no camera.
    """
    text = read_text(path, "the numbers of one camera", _MAX_BYTES)
    if path.suffix.lower() not in {".yaml", ".yml", ".json"}:
        if re.search(r"^\s*cam0\s*=", text, re.MULTILINE):
            return _read_middlebury(path, text, "cam1" if second else "cam0")
        return Calibration(_pinhole_of_numbers(_numbers(text), path, text))
    import yaml

    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(path, f"not valid YAML: {' '.join(str(error).split())}") from error
    try:
        return Calibration(validate(_File, data).root)
    except ValidationError as error:
        problems = "; ".join(map(str, find_problems(error, _File, data)))
        raise InputError(path, problems) from error


def _read_middlebury(path: Path, text: str, camera: str) -> Calibration:
    """Read lines ``name=value``."""
    values = {name.strip(): value for name, _, value in (line.partition("=") for line in text.splitlines())}
    lens = _pinhole_of_numbers(_numbers(values.get(camera, "").strip(" []")), path, f"{camera}={values.get(camera)}")
    found: dict[str, float] = {}
    for name in ("baseline", "doffs"):
        numbers = _numbers(values.get(name, ""))
        if numbers.size != 1 or not np.isfinite(numbers[0]):
            raise InputError(
                path, f"got {name}={values.get(name, '')}, expected a line {name}= with one number: fetch it again"
            )
        found[name] = float(numbers[0])
    return Calibration(lens, found["baseline"], found["doffs"])


def _numbers(text: str) -> NDArray[np.float64]:
    """The numbers in a text, parted by commas, semicolons or blanks; none where it holds a word."""
    try:
        return np.array([float(word) for word in re.split(r"[\s,;]+", text.strip())])
    except ValueError:
        return np.zeros(0)


def _pinhole_of_numbers(numbers: NDArray[np.float64], path: Path, text: str) -> Pinhole:
    if numbers.size == 4:
        fx, fy, cx, cy = numbers.tolist()
        numbers = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    elif numbers.size == 16:  # of homogeneous points
        numbers = numbers.reshape(4, 4)[:3, :3].reshape(-1)
    if numbers.size != 9:
        raise InputError(path, f"got {text[:60]!r}, expected nine numbers: fx, 0, cx, 0, fy, cy, 0, 0, 1")
    return pinhole_of(numbers.reshape(3, 3), str(path))


def nearest_file(root: Path, folder: Path, names: Sequence[str] = FILE_NAMES) -> Path | None:
    """Return the file with intrinsics, of one of these names, in a folder, or in those above it up to the root."""
    for place in (folder, *folder.parents):
        for name in names:
            if (place / name).is_file():
                return place / name
        if place == root:
            break
    return None
