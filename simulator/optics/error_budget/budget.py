"""A PSF stack's error budget: one list of rows, worst first, each with what to change; quick with every stack, or full.

Quick, in seconds, on crops of the mask where that is slow: sampling (proven before the stack is computed), wavelengths per
channel against many, the depth model against ``exact``, light between planes, one PSF for all directions. Full, in minutes:
the same on the whole mask and between all planes, and the model against the direct Rayleigh-Sommerfeld sum at points.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from simulator.arrays import number
from simulator.errors import InputError
from simulator.optics.error_budget.direct_sum import llvm_works
from simulator.optics.error_budget.field import field_error
from simulator.optics.error_budget.model import direct_error, pixel_error, rim_error, three_depths, three_wavelengths
from simulator.optics.error_budget.planes import GOAL, WARN, planes_error
from simulator.optics.error_budget.sampling import MOST, judged_crop, prove_sampling
from simulator.optics.error_budget.spectrum import spectral_error
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, compute_psf_stack
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.text import share
from simulator.types import CameraGeometry, View

PLAIN_CROP_M = 0.5e-3  # of the mask in the direct sum without LLVM: 20 points take a second per depth and wavelength


# ---- rows


@dataclass(frozen=True)
class BudgetRow:
    """One error of a stack, or of the measurements made with it.

    Attributes:
        name: what causes it.
        value: relative L2 error, or share of light.
        kind: of what ``value`` is the error.
        change: what to change to make it smaller.
        warn: whether it is larger than it should be.
    """

    name: str
    value: float
    kind: str
    change: str
    warn: bool = False


def with_budget(stack: PsfStack, errors: dict[str, Any], more: Sequence[BudgetRow] = ()) -> PsfStack:
    """Return a computed stack that carries measured errors, from ``quick_errors`` or ``full_errors``, and their rows."""
    judged = replace(stack, provenance=stack.provenance | {"errors": errors})
    return with_rows(judged, [*budget_rows(stack.provenance["sampling"], errors), *more])


def with_rows(stack: PsfStack, rows: Sequence[BudgetRow]) -> PsfStack:
    """Return a stack that carries rows as ``provenance["budget"]``, worst first."""
    worst_first = sorted(rows, key=lambda row: -row.value)
    return replace(stack, provenance=stack.provenance | {"budget": [asdict(row) for row in worst_first]})


def read_budget(stack: PsfStack) -> list[BudgetRow]:
    """Return a stack's rows, worst first; none for one that nobody judged."""
    return [BudgetRow(**row) for row in stack.provenance.get("budget", [])]


def budget_lines(stack: PsfStack) -> list[str]:
    """Return a heading, a line per row (how large, its cause, of what it is the error, what to change) and warnings."""
    rows = read_budget(stack)
    noted = [f"warning: {line}" for line in stack.provenance.get("warnings", [])]
    shown = [(share(row.value), row.name, row.kind, row.change) for row in rows]
    if not shown:
        return noted
    value, name, kind, _ = (max(map(len, column)) for column in zip(*shown, strict=True))
    lines = [f"  {a:>{value}}  {b:{name}}  {c:{kind}}  {d}" for a, b, c, d in shown]
    warnings = [f"warning: {row.name}: {share(row.value)}, {row.kind}; {row.change}" for row in rows if row.warn]
    return ["error budget, worst first (relative L2 errors, and what makes them smaller):", *lines, *warnings, *noted]


def budget_rows(sampling: dict[str, Any] | str, errors: dict[str, Any]) -> list[BudgetRow]:
    """Return the rows of a sampling proof and of errors that were measured; what was not is left out."""
    rows = []
    if sampling != UNPROVEN:
        assert isinstance(sampling, dict)
        finer = sampling["oversampling"][1]
        change = f"psf.oversampling: {finer}" if finer <= MOST else "a mask of finer samples (pixel_um)"
        rows.append(BudgetRow("sampling", sampling["error"], "PSF, grid against one twice as fine", change))
    if "spectrum" in errors:
        spectrum = errors["spectrum"]
        worst = max(spectrum["channels"], key=spectrum["channels"].get)
        change = f"psf.shared_wavelengths: {spectrum['better']}"
        rows.append(BudgetRow("wavelengths", spectrum["error"], f"PSF, channel {worst}", change))
    if "model" in errors:
        kind = "PSF, against exact" + (", estimated" if errors["model"].get("from_axis_m") else "")
        rows.append(BudgetRow("depth model", errors["model"]["error"], kind, "psf.model: exact"))
    if "planes" in errors:
        planes = errors["planes"]
        enough = planes.get("enough")
        change = "more psf.depths" if enough is None else f"psf.depths: {enough} brings it below {share(GOAL)}"
        rows.append(BudgetRow("planes", planes["error"], "PSF half-way between planes", change, planes["error"] > WARN))
    if "field" in errors:
        field, change = errors["field"], "a narrower scene.size: one PSF serves all directions"
        kinds = {"error": "PSF off the axis, rms", "texture": "measurement of textures"}
        kinds["points"] = "measurement of sparse points"
        rows += [BudgetRow("field", field[key], kind, change) for key, kind in kinds.items()]
    return rows


# ---- stacks and their errors


def proven_psf_stack(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    *,
    xp: str = "numpy",
    threads: int = 1,
    progress: Progress | None = None,
) -> PsfStack:
    """Prove the sampling and compute a stack; arguments as for ``compute_psf_stack``.

    Returns:
        The stack; ``provenance["sampling"]`` holds the measured sampling error, which sees twice as many diffraction orders
        as the stack follows. ``with_budget(stack, quick_errors(...))`` adds the other errors.

    Raises:
        InputError: when the sampling error is above 5 % (or ``accept_error``), or the mask and camera do not fit.
    """
    sampling = prove_sampling(mask, _plain(camera), psf_config)
    stack = compute_psf_stack(mask, camera, psf_config, xp=xp, threads=threads, progress=progress)
    return replace(stack, provenance=stack.provenance | {"sampling": sampling})


def quick_errors(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    view: View | None = None,
    *,
    stack: PsfStack | None = None,
    threads: int = 1,
) -> dict[str, Any]:
    """Return what a stack records of its errors beside the sampling error; JSON-serialisable.

    ``spectrum``: see ``spectral_error``; ``model``: see ``rim_error``, absent where the model is ``exact``; ``planes``: see
    ``planes_error``, absent where one plane is all that the scene has; ``field``: see ``field_error``, absent without a view.

    Args:
        mask: the mask.
        camera: distance or layers, binned pixel pitch, spectral response.
        psf_config: depths, model, wavelengths, sampling.
        view: directions and depths of the scene.
        stack: the PSFs of these arguments, where they are there already.
        threads: parts that are measured at a time.
    """
    camera = _plain(camera)
    wavelength_m = _middle(three_wavelengths(camera, psf_config))
    with ThreadPoolExecutor(threads) as pool:
        parts: dict[str, Future[dict[str, Any] | None]] = {}
        if view is not None:  # the longest first
            parts["field"] = pool.submit(field_error, mask, camera, psf_config, wavelength_m, view)
        if psf_config.model != "exact":
            parts["model"] = pool.submit(rim_error, mask, camera, psf_config, wavelength_m)
        parts["planes"] = pool.submit(planes_error, mask, camera, psf_config, stack, view)
        parts["spectrum"] = pool.submit(spectral_error, mask, camera, psf_config)
        found = {name: part.result() for name, part in parts.items()}
    return {"check": "quick"} | {name: report for name, report in found.items() if report is not None}


def full_errors(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    view: View | None = None,
    *,
    stack: PsfStack | None = None,
    threads: int = 1,
    progress: dict[str, Progress] | None = None,
) -> dict[str, Any]:
    """Return the full error budget; JSON-serialisable. Arguments as for ``quick_errors``.

    The parts are those of ``quick_errors``, on the whole mask (on a piece of it where memory does not hold the whole), the
    model at three depths, light between all planes; and ``direct_sum``: three depths and wavelengths against the
    Rayleigh-Sommerfeld sum at random points, on a crop of the mask where there is no LLVM, absent where light crosses layers,
    since the sum knows air only. ``progress`` holds functions called with (done, total), by the name of the part.
    """
    camera, told = _plain(camera), progress or {}
    some = replace(psf_config, depths_m=three_depths(psf_config.depths_m))
    wavelengths_m = three_wavelengths(camera, psf_config)
    wavelength_m = _middle(wavelengths_m)
    errors: dict[str, Any] = {"check": "full", "spectrum": spectral_error(mask, camera, psf_config)}
    if psf_config.model != "exact":
        try:
            errors["model"] = pixel_error(
                mask, camera, some, [wavelength_m], threads=threads, progress=told.get("model")
            )
        except InputError:  # only the grid's size can be wrong by now
            errors["model"] = rim_error(mask, camera, psf_config, wavelength_m)
    planes = planes_error(
        mask, camera, psf_config, stack, view, every=True, threads=threads, progress=told.get("planes")
    )
    if planes is not None:
        errors["planes"] = planes
    if not camera.gap and not camera.window:
        part = mask if llvm_works() else judged_crop(mask, PLAIN_CROP_M)
        errors["direct_sum"] = direct_error(part, camera, some, wavelengths_m, progress=told.get("direct_sum"))
        errors["direct_sum"]["crop_m"] = max(part.shape) * part.pitch_m
    if view is not None:
        judge = partial(field_error, threads=threads, progress=told.get("field"))
        try:
            errors["field"] = judge(mask, camera, psf_config, wavelength_m, view, crop_m=None)
        except InputError:
            errors["field"] = judge(mask, camera, psf_config, wavelength_m, view)
    return errors


def _plain(camera: CameraGeometry) -> CameraGeometry:
    """Return a camera whose distance is a number: it may be a tensor with a gradient."""
    return replace(camera, mask_to_sensor_m=number(camera.mask_to_sensor_m))


def _middle(wavelengths_m: list[float]) -> float:
    return wavelengths_m[len(wavelengths_m) // 2]
