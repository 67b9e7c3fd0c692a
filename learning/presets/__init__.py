"""Trainings, tunings, evaluations to start from: a commented YAML file each; `flatlight init --preset NAME` copies one."""

from __future__ import annotations

from importlib.resources import files


def preset_texts() -> dict[str, str]:
    """Return the YAML of each preset, by name.

    Example:
        >>> [name for name in preset_texts() if name.startswith("flatnet")]
        ['flatnet2d_64', 'flatnet3d_64', 'flatnet3d_refined_64', 'flatnet3d_thesis', 'flatnet3d_tiny']
    """
    found = sorted((entry for entry in files(__name__).iterdir() if entry.name.endswith(".yaml")), key=lambda e: e.name)
    return {entry.name.removesuffix(".yaml"): entry.read_text(encoding="utf-8") for entry in found}
