"""Statistics against cases that are known: textbooks, SciPy, power tables, coverage by simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cell.trials import statistics as s

# Student (1908), additional hours of sleep by two drugs, the classic paired data set.
FIRST = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
SECOND = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
PERSON = np.repeat(np.arange(5), 2)


def test_students_sleep_data_give_the_published_difference() -> None:
    found = s.paired(SECOND + 5.0, FIRST + 5.0, PERSON)
    assert found.pairs == 10 and found.persons == 5
    assert found.mean == pytest.approx(1.58) and found.sd == pytest.approx(1.2300, abs=1e-4)
    assert found.effect == pytest.approx(1.2846, abs=1e-4)
    assert found.ci[0] < 1.58 < found.ci[1]
    low, high = stats.ttest_rel(SECOND, FIRST).confidence_interval()
    assert abs(found.ci[0] - low) < 0.5 and abs(found.ci[1] - high) < 0.5
    assert found.share == pytest.approx(1.58 / 5.75)


def test_exact_permutation_counts_changes_of_signs() -> None:
    assert s.permutation_p(np.array([1.0, 1.0, 1.0])) == pytest.approx(2 / 8)
    assert s.permutation_p(np.array([1.0, -1.0])) == 1.0
    assert s.permutation_p(np.arange(1.0, 11.0)) == pytest.approx(2 / 1024)
    scipys = stats.permutation_test(
        (SECOND - FIRST,), lambda x, axis: x.mean(axis), permutation_type="samples", n_resamples=np.inf
    )
    assert s.permutation_p(SECOND - FIRST) == pytest.approx(scipys.pvalue, abs=1e-9)


def test_many_pairs_are_sampled_and_agree_with_the_t_test() -> None:
    d = np.random.default_rng(3).normal(0.5, 1.0, 30)
    assert s.permutation_p(d) == pytest.approx(stats.ttest_1samp(d, 0.0).pvalue, rel=0.25)


def test_fifteen_pairs_of_one_sign_are_significant_at_one_percent() -> None:
    assert s.permutation_p(np.full(15, -3.0)) == pytest.approx(2 / 2**15)
    assert s.wilcoxon_p(-np.arange(1.0, 16.0)) == pytest.approx(2 / 2**15)


def test_persons_as_random_effects_equal_the_t_test_of_person_means() -> None:
    rng = np.random.default_rng(1)
    groups = [rng.normal(-20.0 + rng.normal(0, 5), 3.0, 3) for _ in range(5)]
    found = s.persons_random(groups)
    reference = stats.ttest_1samp([g.mean() for g in groups], 0.0)
    assert found["person_p"] == pytest.approx(reference.pvalue)
    low, high = reference.confidence_interval()
    assert found["person_ci"] == pytest.approx((low, high))
    assert found["residual_sd"] == pytest.approx(np.sqrt(np.mean([g.var(ddof=1) for g in groups])))


def test_the_parts_of_the_variance_are_recovered() -> None:
    rng = np.random.default_rng(2)
    groups = [rng.normal(rng.normal(10.0, 4.0), 2.0, 6) for _ in range(400)]
    found = s.persons_random(groups)
    assert found["person_sd"] == pytest.approx(4.0, rel=0.1)
    assert found["residual_sd"] == pytest.approx(2.0, rel=0.05)
    assert s.persons_random([np.array([1.0, 2.0]), np.array([1.5, 1.5])])["person_sd"] == 0.0


def test_the_bootstrap_interval_covers_the_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(60):
        low, high = s.bootstrap(rng.normal(3.0, 2.0, 20))
        inside += low <= 3.0 <= high
    assert 51 <= inside <= 60


def test_power_agrees_with_published_tables() -> None:
    # Cohen (1988) and G*Power: paired t-test, two-sided
    assert s.power(0.5, 34) == pytest.approx(0.808, abs=0.002)
    assert s.power(0.8, 15) == pytest.approx(0.821, abs=0.003)
    assert s.power(0.0, 15) == pytest.approx(0.05, abs=1e-4)
    assert s.pairs_for(0.5) == 34 and s.pairs_for(0.2) == 199
    assert s.detectable(15) == pytest.approx(0.778, abs=0.003)
    assert s.power(1e6, 2) > 0.9 and s.power(1e6, 15) == pytest.approx(1.0)
    assert s.pairs_for(0.0) is None and s.pairs_for(float("nan")) is None


def test_differences_without_spread_stay_defined() -> None:
    found = s.paired(np.array([1.0, 1.0]), np.array([2.0, 2.0]), np.array([1, 2])).as_dict()
    assert found["mean"] == -1.0 and found["ci"] == [-1.0, -1.0] and found["effect"] is None
    same = s.paired(np.ones(4), np.ones(4), np.array([1, 1, 2, 2])).as_dict()
    assert same["p_wilcoxon"] == 1.0 and same["p_permutation"] == 1.0 and same["person_p"] is None
