"""Claims on the sensitivity of the frequency (Fig. 4): finite-range fits, beside the law that holds in the end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from casadi_skin.studies.paper.claim import Claim, Verdict, claim
from casadi_skin.studies.paper.paper_data import (
    GAMMA,
    SITES,
    SIZE_GAMMAS,
    STATED_P,
    STATED_Q,
    PaperData,
    analytical_sensitivity,
)

LARGE = 4000  # a size at which (N+1)^3 times the sensitivity has settled to three digits


def decay_rate(N: int, gamma: float) -> float:
    """Local rate q = -d ln S/dN of the analytical sensitivity, central difference over two sites."""
    return -0.5 * float(np.log(analytical_sensitivity(N + 1, gamma) / analytical_sensitivity(N - 1, gamma)))


def power_of_r(N: int, gamma: float) -> float:
    """Local power p = -d ln S/d ln r of the analytical sensitivity."""
    step = 1e-4
    below, above = gamma - step, gamma + step
    logs = [2 * np.arctanh(g) for g in (below, above)]
    return float(-np.log(analytical_sensitivity(N, above) / analytical_sensitivity(N, below)) / (logs[1] - logs[0]))


def sensitivity_claims(data: PaperData) -> Iterator[Claim]:
    """Fig. 4, its inset and caption."""
    series = [*data.sensitivity_by_size.values(), *data.sensitivity_by_gamma.values()]
    worst = max(float(np.max(np.abs(s.numerical / s.analytical - 1))) for s in series)
    yield claim(
        "Fig. 4", "analytical and numerical sensitivity overlap", "excellent agreement",
        f"largest relative difference {worst:.1e} over {sum(s.N.size for s in series)} chains", worst < 0.02,
        "the numerical value is the finite difference over S in (0, 0.01] that the paper uses", 1e-7,
    )  # fmt: skip
    decaying = all(bool(np.all(np.diff(s.analytical[3:]) < 0)) for s in data.sensitivity_by_size.values())
    yield claim(
        "Fig. 4", "the sensitivity decays as the chain grows", "for all gamma",
        "falls from N = 16 to 100 at each gamma", decaying, error=1e-12,
    )  # fmt: skip
    for gamma, stated in STATED_Q.items():
        yield _rate_claim(gamma, stated)
    rates = [decay_rate(SITES, gamma) for gamma in SIZE_GAMMAS]
    yield claim(
        "Fig. 4", "q grows with gamma", "0.06, 0.07, 0.10, 0.15",
        "at N = 24: "
        + ", ".join(f"{q:.3f}" for q in rates)
        + "; at N = 1000: "
        + ", ".join(f"{decay_rate(1000, gamma):.5f}" for gamma in SIZE_GAMMAS),
        Verdict.IN_RANGE, "true of local slopes at a fixed moderate N; for large N all of them are 3/(N+1)", 1e-6,
    )  # fmt: skip
    for N, stated in STATED_P.items():
        values = {gamma: power_of_r(N, gamma) for gamma in (0.15, GAMMA, 0.4, 0.6)}
        near = min(values, key=lambda g: abs(values[g] - stated))
        yield claim(
            "Fig. 4, inset", f"sensitivity ~ r^(-p) with p = {stated:g} at N = {N}", f"{stated:g}",
            "local p: " + ", ".join(f"{p:.2f} at gamma = {g:g}" for g, p in values.items()), Verdict.IN_RANGE,
            f"p is not constant in gamma; of these, gamma = {near:g} comes nearest", 1e-6,
        )  # fmt: skip


def _span(sizes: NDArray[np.int64]) -> str:
    return f"N = {sizes.min()}" + (f" to {sizes.max()}" if sizes.size > 1 else " only")


def _rate_claim(gamma: float, stated: float) -> Claim:
    """The stated exponential rate against the local slope, and the power law that holds in the end."""
    sizes = np.arange(6, 400)
    rates = np.array([decay_rate(int(N), gamma) for N in sizes])
    # Half a unit of the last stated digit; the rate rises from small N and then falls, so take the falling part.
    falling = sizes >= sizes[np.argmax(rates)]
    close = sizes[falling & (np.abs(rates - stated) <= 0.005)]
    limit = (LARGE + 1) ** 3 * analytical_sensitivity(LARGE, gamma)
    where = (
        f"the local slope is {stated:g} within 0.005 for {_span(close)}"
        if close.size
        else (f"no local slope is {stated:g}: the steepest is {rates.max():.3f}, at N = {sizes[np.argmax(rates)]}")
    )
    return claim(
        "Fig. 4", f"sensitivity ~ exp(-q N), q = {stated:g} at gamma = {gamma:g}", f"{stated:g}",
        f"local slope {decay_rate(SITES, gamma):.3f} at N = 24, {decay_rate(100, gamma):.3f} at N = 100",
        Verdict.IN_RANGE if close.size else Verdict.DISAGREES,
        f"{where}; the paper names no range. In the end the law is {limit:.1f} (N+1)^-3", 1e-6,
    )  # fmt: skip
