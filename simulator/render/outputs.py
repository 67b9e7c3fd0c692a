"""What rendering can say of a pixel beside its colour and depth: the names, sizes and meanings of `Clip.extras`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from simulator.errors import InputError

Output = Literal["shape_id", "normal", "albedo", "motion", "hidden"]
OUTPUTS: tuple[str, ...] = get_args(Output)
"""What may be asked for:

- ``shape_id``: int32 ``(T, H, W)``, number of the shape at the pixel's centre, -1 where nothing is seen;
- ``normal``: float32 ``(T, H, W, 3)``, unit shading normal in world axes (x right, y down, z into the scene), towards the
  camera; zero where nothing is seen;
- ``albedo``: float32 ``(T, H, W, 3)``, diffuse reflectance, linear RGB;
- ``motion``: float32 ``(T, H, W, 3)``, where the surface point at the pixel's centre will be in the next frame: pixels to the
  right, pixels down, metres away; zero in the last frame. ``motion_valid``, bool ``(T, H, W)``, is true where that point is
  seen in both frames (in the picture and not hidden);
- ``hidden``: the surfaces behind those that are seen, one layer after the other: ``hidden1_rgb`` float32 ``(T, H, W, 3)``,
  ``hidden1_depth_m`` float32 ``(T, H, W)``, ``hidden1_valid`` bool ``(T, H, W)``, then ``hidden2_...``.
"""


def check_outputs(outputs: Sequence[str]) -> None:
    """Refuse what cannot be rendered.

    Raises:
        InputError: an unknown name, or one that is given twice.
    """
    for name in outputs:
        if name not in OUTPUTS:
            msg = f"render.outputs: got {name!r}, expected some of {', '.join(OUTPUTS)}"
            raise InputError(msg)
    if len(set(outputs)) != len(outputs):
        msg = f"render.outputs: got {list(outputs)}, in which a name comes twice; name each once"
        raise InputError(msg)
