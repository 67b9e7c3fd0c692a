"""Sensors by name: the numbers of a physical pixel."""

from __future__ import annotations

from typing import Any

# Numbers that makers do not publish are typical of the class; every stand-in is labelled nominal in the metadata.
MODELS: dict[str, dict[str, Any]] = {
    "imx183": {
        "pixel_pitch_m": 2.4e-6,
        "physical_shape": (3648, 5472),
        "full_well_e": 15000.0,
        "read_noise_e": 2.7,
        "row_noise_e": 0.3,
        "dark_current_e_per_s": 0.1,
        "dsnu_e": 1.0,
        "prnu": 0.006,
        "black_level_dn": 64.0,
        "bit_depth": 12,
        "peak_quantum_efficiency": 0.6,
        "source": (
            "Sony IMX183 format (5472 x 3648 of 2.4 um); full well, noise, quantum efficiency and spectral response nominal"
        ),
    }
}
