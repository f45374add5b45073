"""Claims on the nonlinear families: frequencies, periods, multiple scales, and the sensitivity of Fig. 4."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from claim import Claim, Verdict, claim, rounds_to
from numpy.typing import NDArray
from paper_data import (
    ALPHA,
    GAMMA,
    MODES,
    REPRESENTATIVE_S,
    SITES,
    SIZE_GAMMAS,
    STATED_P,
    STATED_Q,
    TOLERANCE,
    PaperData,
    analytical_sensitivity,
)
from scipy.optimize import brentq

from casadi_skin import Branch, closed_forms

EXCELLENT = 0.05  # relative error of the shift up to which theory is called in excellent agreement here


def family_claims(data: PaperData) -> Iterator[Claim]:
    """Sec. II from the multiple scales on, Figs. 3 and 7."""
    yield from _theory(data)
    yield from _figure_3(data)
    yield from _periods(data)
    yield from _likeness(data)
    yield from _letters()


def _slope(g: float, mode: int) -> float:
    return closed_forms.frequency_slope(SITES, ALPHA, GAMMA, g, mode)


def _theory(data: PaperData) -> Iterator[Claim]:
    u, v = (f(SITES, GAMMA, 1) for f in (closed_forms.right_eigenvector, closed_forms.left_eigenvector))
    main = 2 / (SITES + 1) * np.sum(v * u**3) / (np.sum(v * u) / ((SITES + 1) / 2))
    appendix = np.sum(v * u**3) / np.sum(v * u)
    yield claim(
        "Sec. II and App. B, mu", "mu = 2g/(N+1) sum v u^3 (text) and g sum v u^3/sum v u (appendix) are the same",
        "equal", f"relative difference {abs(main / appendix - 1):.0e}", abs(main / appendix - 1) < 1e-12, error=1e-14,
    )  # fmt: skip
    rate, slow, eps = 1.3, 0.7, 1e-2  # of exp(rate t + slow T), to which both sides of the expansion are applied
    cross = ((rate + eps**2 * slow) ** 2 - rate**2 - eps**4 * slow**2) / (rate * slow * eps**2)
    yield claim(
        "App. B, orders of eps", "the cross term of (d_t + eps^2 d_T)^2 (eps y1 + ...) is 2 eps d_Tt (eps^0 y1 + ...)",
        "2 eps", f"coefficient of eps^2 d_t d_T: {cross:.6f}, so that 2 eps^3 d_Tt y1 is meant", Verdict.MISPRINT,
        "the factor eps^2 of d_T is missing in the printed line; the next orders have it", 1e-9,
    )  # fmt: skip
    largest = max(b.orbits[0].S for b in (*data.hardening.values(), *data.softening.values()))
    ratios = [
        branch.orbits[0].Omega_shift / (branch.orbits[0].S * _slope(g, mode))
        for g, families in ((1.0, data.hardening), (-1.0, data.softening))
        for mode, branch in families.items()
    ]
    worst = float(np.max(np.abs(np.array(ratios) - 1.0)))
    yield claim(
        "Sec. II, Omega_j",
        "Omega_j = omega_j + 3 S g/(4 (N+1) omega_j) sum r^n sin^4/sum r^n sin^2 to first order in S",
        "exact as S -> 0", f"ratio of shifts at the first point of twelve families: 1 within {worst:.0e}", worst < 1e-3,
        f"S of these points is at most {largest:.0e}", 1e-6,
    )  # fmt: skip
    for mode, branch in data.hardening.items():
        slope = _slope(1.0, mode)
        shifts = {S: branch.at(S=S).Omega_shift / (S * slope) for S in (1.0, 2.0, 3.0)}
        outside = [o.S for o in branch.orbits if abs(o.Omega_shift / (o.S * slope) - 1.0) > EXCELLENT]
        yield claim(
            "Fig. 7, App. B", f"theory and continuation, j = {mode}, g = 1: excellent agreement up to S of 2 and 3",
            "excellent", "true shift/theory " + ", ".join(f"{x:.3f} at S = {S:g}" for S, x in shifts.items()),
            Verdict.IN_RANGE if outside else Verdict.AGREES,
            f"the shift is within {100 * EXCELLENT:.0f} per cent up to S = {outside[0] if outside else 3.0:.2f}; "
            f"{100 * (shifts[3.0] - 1):+.0f} per cent off at S = 3, {abs(shifts[3.0] - 1) * 3 * slope:.3f} in Omega",
            TOLERANCE,
        )  # fmt: skip
    slopes = {m: b.at(S=3.0).Omega_shift / b.at(S=0.2).Omega_shift / 15.0 for m, b in data.softening.items()}
    linear_enough = [m for m, s in slopes.items() if abs(s - 1) < 0.25]
    yield claim(
        "Sec. II", "for g < 0, Omega decreases approximately linearly with S", "approximately",
        "mean slope to S = 3 over that to 0.2: " + ", ".join(f"{s:.2f} (j = {m})" for m, s in slopes.items()),
        Verdict.AGREES if len(linear_enough) == len(slopes) else Verdict.IN_RANGE,
        f"within 25 per cent for j = {', '.join(map(str, linear_enough)) or 'none'} only", TOLERANCE,
    )  # fmt: skip


def _leaves(branch: Branch, edge: float) -> float | None:
    """S at which Omega of a family passes `edge`, or None."""
    difference = branch.Omega - edge
    crossing = np.flatnonzero(difference[:-1] * difference[1:] < 0)
    if crossing.size == 0:
        return None
    low, high = branch.S[crossing[0]], branch.S[crossing[0] + 1]
    return float(brentq(lambda S: branch.at(S=float(S)).Omega - edge, low, high, xtol=1e-10))


def _figure_3(data: PaperData) -> Iterator[Claim]:
    chain = data.chain(1.0)
    omega = chain.linear_frequencies()
    low, high = np.sqrt(chain.band())
    for name, families, sign in (("a", data.hardening, 1), ("d", data.softening, -1)):
        monotone = all(bool(np.all(sign * np.diff(b.Omega) > 0)) for b in families.values())
        direction = "increases" if sign > 0 else "decreases"
        yield claim(
            f"Fig. 3({name})", f"Omega of the six families {direction} monotonically with S", "monotone",
            "monotone at every point computed" if monotone else "not monotone", monotone, error=TOLERANCE,
        )  # fmt: skip
        inside = [m for m, b in families.items() if omega[0] <= b.Omega.min() and b.Omega.max() <= omega[-1]]
        stated = [m for m in MODES if m != (24 if sign > 0 else 1)]
        yield claim(
            f"Fig. 3({name})", f"families {', '.join(map(str, stated))} stay in the linear spectrum up to S = 3",
            ", ".join(map(str, stated)), ", ".join(map(str, inside)), inside == stated, error=TOLERANCE,
        )  # fmt: skip
    ends = (("a", 24, data.hardening[24], high, omega[-1]), ("d", 1, data.softening[1], low, omega[0]))
    for name, mode, branch, cutoff, edge in ends:
        start, at = _leaves(branch, float(cutoff)), branch.at(S=REPRESENTATIVE_S).Omega
        outside = start is None or start <= REPRESENTATIVE_S
        yield claim(
            f"Fig. 3({name})", f"the family j = {mode} has left the linear spectrum: an end breather", "for 0 < S < 3",
            f"outside the {SITES} frequencies from S = 0 on, outside the infinite chain's band from S = {start:.6f}",
            Verdict.AGREES if outside else Verdict.IN_RANGE,
            f"the example at S = 0.2 (Omega = {at:.6f}) lies between omega_{mode} = {edge:.6f} and the cutoff "
            f"{cutoff:.6f}: a decaying tail exists only beyond the cutoff",
            1e-9,
        )  # fmt: skip
    third = 3 * data.softening[1].Omega
    yield claim(
        "Fig. 3(d)", "higher harmonics of the family j = 1 lie in the lower band gap", "lower gap",
        f"3 Omega from {third.max():.3f} to {third.min():.3f}; the band ends at {high:.3f}", Verdict.DISAGREES,
        "they lie above the band, in the upper gap, up to S = 3; 3 Omega meets the band at S = 3.10", 1e-8,
    )  # fmt: skip
    hardening_third = 3 * data.hardening[24].Omega.min()
    yield claim(
        "Fig. 3(a)", "higher harmonics of the family j = 24 lie outside the linear spectrum", "outside",
        f"3 Omega >= {hardening_third:.3f} > {high:.3f}", hardening_third > high, error=1e-8,
    )  # fmt: skip


def _periods(data: PaperData) -> Iterator[Claim]:
    for where, orbit, branch, stated in (
        ("Fig. 3(c)", data.hardening_orbit, data.hardening[24], "2.83"),
        ("Fig. 3(f)", data.softening_orbit, data.end_breather, "6.06"),
    ):
        yield claim(
            where, f"period T_b = {stated} at S = 0.2", stated, f"{orbit.period:.9f}", rounds_to(orbit.period, stated),
            error=orbit.Omega_error * orbit.period / orbit.Omega,
        )  # fmt: skip
        evolution = data.evolution(orbit)
        exact = orbit.evaluate(evolution.t)
        deviation = float(np.max(np.abs(evolution.displacements - exact)) / np.max(np.abs(exact)))
        yield claim(
            where, "integrated to t = 50, the mode oscillates with its period", "periodic",
            f"largest deviation from the periodic orbit {deviation:.0e} of its amplitude", deviation < 1e-5, error=1e-9,
        )  # fmt: skip
        other, size = branch.at(S=REPRESENTATIVE_S**2).period, "||y|| = 0.2" if "3(c)" in where else "||y||^2 = 0.2"
        yield claim(
            where, f"the mode shown has {size}", size,
            f"period {orbit.period:.4f} at ||y||^2 = 0.2, {other:.4f} at ||y|| = 0.2",
            Verdict.MISPRINT if "3(c)" in where else Verdict.AGREES,
            "figure and caption say ||y||^2 = 0.2; the text drops the square (also in 0 < ||y|| < 3)"
            if "3(c)" in where
            else "",
            1e-9,
        )  # fmt: skip


def _likeness(data: PaperData) -> Iterator[Claim]:
    """The profiles of Fig. 3 beside the linear modes."""
    for where, orbit, mode in (("Fig. 3(b)", data.hardening_orbit, SITES), ("Fig. 3(e)", data.softening_orbit, 1)):
        linear_mode = closed_forms.right_eigenvector(SITES, GAMMA, mode)
        overlap = abs(float(linear_mode @ orbit.profile))
        overlap /= float(np.linalg.norm(linear_mode) * np.linalg.norm(orbit.profile))
        yield claim(
            where, f"the profile of j = {mode} is similar to the linear skin mode", "similar",
            f"overlap {overlap:.4f} at S = 0.2", overlap > 0.99, error=orbit.profile_error,
        )  # fmt: skip


def _letters() -> Iterator[Claim]:
    yield claim(
        "Fig. 5, caption", "the mode of the first complex plane has ||y|| = 1", "||y|| = 1", "||y||^2 = 1 in the text",
        Verdict.MISPRINT, "the caption drops the square, which makes no difference at 1",
    )  # fmt: skip
    yield claim(
        "Sec. II on Fig. 3(d)", "families j = 2, 6, 10, 14, 18, 24 stay in the spectrum", "j = 2",
        "figure and caption: j = 1", Verdict.MISPRINT,
        "no family j = 2 is drawn, and j = 1 is the one that leaves: the list starts with 6",
    )  # fmt: skip
    yield claim(
        "Fig. 4, caption and text", "colours of N = 24, 32, 42 in the inset", "blue, red, cyan (caption)",
        "red, blue, cyan (text)", Verdict.MISPRINT, "caption and text name different colours for N = 24 and N = 32",
    )  # fmt: skip
    yield claim(
        "Fig. 5, caption and text", "panel letters of the multipliers in the complex plane", "(a)-(b) (caption)",
        "(c) and (d) (text), (b) and (c) (figure)", Verdict.MISPRINT,
        "the letters do not fit the four panels either way",
    )  # fmt: skip
    yield claim(
        "App. B on Fig. 7", "families compared in Fig. 7", "five listed in the text, see Fig. 3(b)",
        "six in the caption, see Fig. 3(a)", Verdict.MISPRINT,
        "the text leaves out j = 10 and refers to the wrong panel",
    )  # fmt: skip


# Sensitivity (figure 4) -----------------------------------------------------------------------------------------------


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
    yield from _laws(data)
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


def _laws(data: PaperData) -> Iterator[Claim]:
    """The text's expectation of the sensitivity, beside that of its fit."""
    powers = {
        N: -float(np.log(analytical_sensitivity(N + 1, GAMMA) / analytical_sensitivity(N - 1, GAMMA)))
        / float(np.log((N + 2) / N))
        for N in (24, 100, LARGE)
    }
    yield claim(
        "Sec. II, after the sensitivity", "a power law in N is expected", "power law",
        "local power of 1/(N+1): " + ", ".join(f"{p:.3f} at N = {N}" for N, p in powers.items()),
        abs(powers[LARGE] - 3.0) < 0.01,
        "right in the end, with power 3; the exponential that the text then fits holds nowhere for long", 1e-6,
    )  # fmt: skip
    power = power_of_r(SITES, GAMMA)
    yield claim(
        "Fig. 4, inset", "S ~ r^p is expected, with p = p(N)", "r^p, then r^-p",
        f"S falls with r: the power of r is {-power:.2f} at N = 24, gamma = {GAMMA:g}",
        Verdict.MISPRINT if power > 0 else Verdict.AGREES, "the sign differs from the fit, which is right", 1e-6,
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
        f"{where}; the paper fits its last five points, whose N it does not name. In the end the law is "
        f"{limit:.1f} (N+1)^-3", 1e-6,
    )  # fmt: skip
