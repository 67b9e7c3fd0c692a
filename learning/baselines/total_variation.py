"""Anisotropic total variation over rows and columns of a picture, its operators and its proximal step.

|grad S|_1 = sum |S[i + 1, j] - S[i, j]| + |S[i, j + 1] - S[i, j]|, differences inside the picture only. Not over depth: a
surface lies in one plane and not in the next, and planes are not evenly spaced.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def differences(picture: Tensor) -> tuple[Tensor, Tensor]:
    """Return D S of ``(..., h, w)``: between rows ``(..., h - 1, w)`` and between columns ``(..., h, w - 1)``."""
    return picture.diff(dim=-2), picture.diff(dim=-1)


def add_adjoint(picture: Tensor, rows: Tensor, columns: Tensor) -> None:
    """Add D^T of differences to a picture ``(..., h, w)``, in place."""
    picture[..., 1:, :] += rows
    picture[..., :-1, :] -= rows
    picture[..., 1:] += columns
    picture[..., :-1] -= columns


def difference_power(rows: int, columns: int, dtype: torch.dtype) -> Tensor:
    """Return |F D|^2, ``(rows, columns // 2 + 1)``: the spectrum of D^T D on a periodic grid."""
    tall = 2 - 2 * torch.cos(2 * math.pi * torch.arange(rows, dtype=torch.float64) / rows)
    wide = 2 - 2 * torch.cos(2 * math.pi * torch.arange(columns // 2 + 1, dtype=torch.float64) / columns)
    return (tall[:, None] + wide).to(dtype)


def total_variation(picture: Tensor) -> Tensor:
    """Return |grad S|_1 of pictures ``(..., h, w)``, ``(...)``."""
    rows, columns = differences(picture)
    return rows.abs().sum(dim=(-2, -1)) + columns.abs().sum(dim=(-2, -1))
