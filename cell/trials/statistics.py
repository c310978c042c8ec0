"""Paired comparison of two policies: difference with interval, tests, effect size, power.

Rounds of one person and block share batch and chance, so that the difference within a pair is what
counts. Pairs of one person are not independent: beside the plain paired figures there is one that
takes persons as random, as a mixed model with person effects would for this balanced design.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy import stats

from cell.frames import Array

LEVEL = 0.95
_RESAMPLES = 10_000
_EXACT = 16
"""Up to so many pairs all changes of signs are gone through."""
_SEED = 20_250_607
_STEPS = 2000


@dataclass(frozen=True)
class Paired:
    """First policy minus second, in the unit of the values.

    Attributes:
        pairs, persons: how many. mean, sd: of the differences. ci: bootstrap interval of the mean
            (BCa over pairs). share: mean difference over the second's mean; share_ci its interval.
        p_permutation: two-sided, by changing signs (exact up to 16 pairs). p_wilcoxon: signed ranks.
        by_person: mean difference per person. person_mean, person_ci, person_p: persons as random effects.
        person_sd, residual_sd: between persons, and within. effect: Cohen's d_z; effect_g: Hedges' g.
    """

    pairs: int
    persons: int
    first_mean: float
    second_mean: float
    mean: float
    sd: float
    ci: tuple[float, float]
    share: float
    share_ci: tuple[float, float]
    p_permutation: float
    p_wilcoxon: float
    by_person: tuple[float, ...]
    person_mean: float
    person_ci: tuple[float, float]
    person_p: float
    person_sd: float
    residual_sd: float
    effect: float
    effect_g: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON; what is undefined becomes None."""
        return {k: _plain(v) for k, v in asdict(self).items()}


def paired(first: Array, second: Array, person: Array) -> Paired:
    """Compare values (n,) of two policies in n pairs; `person` (n,) says whose each pair is."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    difference = first - second
    n = len(difference)
    mean, sd = float(difference.mean()), float(difference.std(ddof=1)) if n > 1 else 0.0
    who = np.unique(person)
    means = np.array([difference[person == p].mean() for p in who])
    model = persons_random([difference[person == p] for p in who])
    dz = mean / sd if sd > 0.0 else float("nan")
    correction = 1.0 - 3.0 / (4.0 * (n - 1) - 1.0) if n > 2 else float("nan")
    return Paired(
        pairs=n,
        persons=len(who),
        first_mean=float(first.mean()),
        second_mean=float(second.mean()),
        mean=mean,
        sd=sd,
        ci=bootstrap(difference),
        share=mean / float(second.mean()),
        share_ci=bootstrap_share(difference, second),
        p_permutation=permutation_p(difference),
        p_wilcoxon=wilcoxon_p(difference),
        by_person=tuple(float(m) for m in means),
        effect=dz,
        effect_g=dz * correction,
        **model,
    )


def persons_random(groups: list[Array]) -> dict[str, Any]:
    """Mean difference with persons as random effects: d_pk = mean + person_p + e_pk.

    The person means are averaged; their spread carries both parts of the variance, so that the
    interval is Student's with persons - 1 degrees of freedom (for equal numbers of pairs the
    restricted maximum likelihood answer). Variances by the method of moments, not below 0.
    """
    means = np.array([g.mean() for g in groups])
    count, total = len(groups), sum(len(g) for g in groups)
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups)
    residual = within / (total - count) if total > count else float("nan")
    out = {"person_mean": float(means.mean()), "residual_sd": float(np.sqrt(residual))}
    if count < 2:
        nothing = float("nan")
        return {**out, "person_ci": (nothing, nothing), "person_p": nothing, "person_sd": nothing}
    variance = float(means.var(ddof=1))
    size = count / sum(1.0 / len(g) for g in groups)  # harmonic mean of the pairs per person
    between = max(0.0, variance - residual / size) if residual == residual else variance
    error = float(np.sqrt(variance / count))
    half = float(stats.t.ppf(0.5 + LEVEL / 2, count - 1)) * error
    p = 2.0 * float(stats.t.sf(abs(means.mean()) / error, count - 1)) if error > 0.0 else float("nan")
    ci = (float(means.mean()) - half, float(means.mean()) + half)
    return {**out, "person_ci": ci, "person_p": p, "person_sd": float(np.sqrt(between))}


def bootstrap(values: Array) -> tuple[float, float]:
    """95 % interval of the mean of values (n,): bias-corrected and accelerated, over pairs."""
    if len(values) < 2 or np.ptp(values) == 0.0:
        return (float(values.mean()), float(values.mean())) if len(values) > 1 else (float("nan"),) * 2
    rng = np.random.default_rng(_SEED)
    found = stats.bootstrap(
        (values,), np.mean, confidence_level=LEVEL, n_resamples=_RESAMPLES, method="BCa", rng=rng
    ).confidence_interval
    return float(found.low), float(found.high)


def bootstrap_share(difference: Array, second: Array) -> tuple[float, float]:
    """95 % interval of mean(difference) / mean(second), by percentiles, over pairs."""
    n = len(difference)
    if n < 2:
        return float("nan"), float("nan")
    rows = np.random.default_rng(_SEED).integers(n, size=(_RESAMPLES, n))
    ratio = difference[rows].mean(axis=1) / second[rows].mean(axis=1)
    low, high = np.quantile(ratio, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return float(low), float(high)


def permutation_p(difference: Array) -> float:
    """Two-sided p of mean 0 by changing the signs of differences (n,); exact up to 16 pairs."""
    n = len(difference)
    if n == 0:
        return float("nan")
    if n <= _EXACT:
        flips = np.array(list(product((1.0, -1.0), repeat=n)))
        sums = np.abs(flips @ difference)
        return float((sums >= abs(difference.sum()) - 1e-9).mean())
    rng = np.random.default_rng(_SEED)
    flips = rng.choice((1.0, -1.0), size=(100_000, n))
    beyond = int((np.abs(flips @ difference) >= abs(difference.sum()) - 1e-9).sum())
    return (beyond + 1) / (len(flips) + 1)


def wilcoxon_p(difference: Array) -> float:
    """Two-sided p of Wilcoxon's signed ranks; 1 where all differences are 0."""
    if not len(difference) or not difference.any():
        return 1.0
    return float(stats.wilcoxon(difference).pvalue)


def power(effect: float, pairs: int, alpha: float = 0.05) -> float:
    """Power of the two-sided paired t-test for an effect d_z with so many pairs."""
    if pairs < 2:
        return float("nan")
    df, shift = pairs - 1, abs(effect) * float(np.sqrt(pairs))
    edge = float(stats.t.ppf(1 - alpha / 2, df))
    # The noncentral t as a normal over a chi; SciPy's own is not a number for large effects.
    chance = (np.arange(_STEPS) + 0.5) / _STEPS
    spread = stats.chi.ppf(chance, df) / np.sqrt(df)
    return float((stats.norm.sf(edge * spread - shift) + stats.norm.cdf(-edge * spread - shift)).mean())


def detectable(pairs: int, alpha: float = 0.05, wanted: float = 0.8) -> float:
    """Least effect d_z that so many pairs find with a power of `wanted`."""
    if pairs < 2:
        return float("nan")
    low, high = 0.0, 50.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if power(middle, pairs, alpha) < wanted else (low, middle)
    return high


def pairs_for(effect: float, alpha: float = 0.05, wanted: float = 0.8) -> int | None:
    """Least number of pairs that find an effect d_z with a power of `wanted`; None above 10,000."""
    if not np.isfinite(effect) or effect == 0.0:
        return None
    low, high = 2, 10_000
    if power(effect, high, alpha) < wanted:
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (middle + 1, high) if power(effect, middle, alpha) < wanted else (low, middle)
    return low


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return round(value, 6) if np.isfinite(value) else None
    return value
