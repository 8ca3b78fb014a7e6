"""Fields made by hand: a lens by its Seidel sums, and the truth of an independent simulator."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labkit.optics.field import FieldFrame, FieldModel, field_terms
from labkit.optics.zernike import zernike
from labkit.types import Floats

GOLDEN_FIELD = Path(__file__).parents[2] / "shared" / "golden" / "truth-field-open.json"
FRAME = FieldFrame((512, 768), 5.2)
NOLL = tuple(range(4, 16))
SIMULATORS_PUPIL = 1.05
"""Pupil magnification of the simulator's lens, which its file does not state; with 1.0 lengths would differ by 0.27 %."""

Paths = Callable[[Floats, Floats, Floats, Floats], Floats]
"""A path difference, waves, by the place (x, y in mm) and the pupil's coordinates."""


def a_field(
    waves: Floats | None = None, std: float = 0.001, order: int = 2, **changed: Any
) -> FieldModel:
    """One channel with independent errors."""
    field = field_terms(order)
    if waves is None:
        waves = np.zeros((1, len(field), len(NOLL)))
    covariance = std**2 * np.eye(waves.size)
    made = FieldModel(
        FRAME, ("G",), field, NOLL, waves, covariance, (540.0,), 450.0, 4.0, 0.0
    )
    return replace(made, **changed)


def of_path(path: Paths, order: int = 2, std: float = 0.001) -> FieldModel:
    """Return the double Zernike expansion of a path difference, by quadrature over field and pupil."""
    node, weight = np.polynomial.legendre.leggauss(8)
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rho, theta = (a.ravel() for a in np.meshgrid((1 + node) / 2, angles))
    area = np.tile(weight * (1 + node) / 2, len(angles)) / len(angles)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    far = FRAME.radius_mm
    waves = path(far * x[:, None], far * y[:, None], x[None, :], y[None, :])
    by_field = np.array([zernike(k, rho, theta) * area for k in field_terms(order)])
    by_pupil = np.array([zernike(j, rho, theta) * area for j in NOLL])
    return a_field((by_field @ waves @ by_pupil.T)[None], std, order)


def golden_field(std: float = 0.001) -> FieldModel:
    """The green channel of the simulator's lens at its middle range."""
    truth = json.loads(GOLDEN_FIELD.read_text())
    tiles = [tile for tile in truth["tiles"] if tile["channel"] == "G"]
    field = field_terms(2)
    at = FRAME.polynomials(field, [tile["centre_px"] for tile in tiles]).T
    ranges = np.array([tile["range_mm"] for tile in tiles])
    others = [ranges == r for r in np.unique(ranges)[[0, -1]]]
    waves = np.zeros((1, len(field), len(NOLL)))
    for place, j in enumerate(NOLL):
        modes = np.array([tile["modes"][str(j)] for tile in tiles])
        basis = np.column_stack([at, *others]) if j == 4 else at
        waves[0, :, place] = np.linalg.lstsq(basis, modes, rcond=None)[0][: len(field)]
    f_mm, focus_mm = truth["focal_length_mm"], truth["best_focus_mm"]["G"]
    cone = 1 + f_mm / (focus_mm - f_mm) / SIMULATORS_PUPIL
    return a_field(waves, std, f_number=truth["f_number"] * cone)


def drawn(model: FieldModel, rng: np.random.Generator) -> FieldModel:
    """Return a field with coefficients drawn by the model's errors, and without errors."""
    waves = rng.multivariate_normal(model.waves.ravel(), model.covariance)
    return replace(
        model,
        waves=waves.reshape(model.waves.shape),
        covariance=np.zeros_like(model.covariance),
    )
