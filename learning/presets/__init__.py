"""Trainings to start from, one commented YAML file each; `flatlight init --preset NAME` writes a copy."""

from __future__ import annotations

from importlib.resources import files


def preset_texts() -> dict[str, str]:
    """Return the YAML of each preset, by name.

    Example:
        >>> sorted(preset_texts())
        ['endoscopy_fine_tuning_64', 'flatnet2d_64', 'flatnet3d_64', 'flatnet3d_thesis', 'flatnet3d_tiny']
    """
    found = sorted((entry for entry in files(__name__).iterdir() if entry.name.endswith(".yaml")), key=lambda e: e.name)
    return {entry.name.removesuffix(".yaml"): entry.read_text(encoding="utf-8") for entry in found}
