"""Theorem 1's bound and what is measured for it."""

from __future__ import annotations

import numpy as np
import pytest

from cell.learn.theory import bound, change_ratios


def test_bound_by_hand() -> None:
    # 8 * 2 * 0.14 / (1 - 0.95) and, with delta 1, / (1 - 0.475)
    assert bound(2, 0.14, 0.95, 0.0) == pytest.approx(44.8)
    assert bound(2, 0.14, 0.95, 1.0) == pytest.approx(2.24 / 0.525)


def test_belief_change_ratios() -> None:
    belief = np.array([0.0, 0.5, 0.75, 0.75, 1.0], np.float32).reshape(-1, 1, 1, 1)
    assert change_ratios(belief).tolist() == [0.5, 0.0]
