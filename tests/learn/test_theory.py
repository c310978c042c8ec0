"""Theorem 1's bound and what is measured for it."""

from __future__ import annotations

import numpy as np
import pytest

from cell.learn.belief.eq3 import fit_kernel
from cell.learn.theory import bound, change_ratios, contraction


def test_bound_by_hand() -> None:
    # 8 * 2 * 0.14 / (1 - 0.95) and, with delta 1, / (1 - 0.475)
    assert bound(2, 0.14, 0.95, 0.0) == pytest.approx(44.8)
    assert bound(2, 0.14, 0.95, 1.0) == pytest.approx(2.24 / 0.525)


def test_belief_change_ratios() -> None:
    belief = np.array([0.0, 0.5, 0.75, 0.75, 1.0], np.float32).reshape(-1, 1, 1, 1)
    assert change_ratios(belief).tolist() == [0.5, 0.0]


def test_contraction_by_hand() -> None:
    """After No-op one of two rests goes on and nobody tires; after thumbs-down all are rested; no Pick."""
    observed = np.array([[0, 0, 0], [8, 8, 8]], np.int8)
    types = np.array([[0, 1, 1], [0, 1, 0], [0, 0, 0]], np.int8)
    delta = contraction(fit_kernel(observed, types))
    assert delta["no_op"] == pytest.approx(0.5)
    assert delta["pick"] is None and delta["slow_down"] == pytest.approx(0.0)
