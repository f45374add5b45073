"""Claims on stability, Floquet vectors and perturbed dynamics (Figs. 3, 5 and 6)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from claim import Claim, Verdict, claim
from paper_data import GAMMA, KICK, SITES, TOLERANCE, PaperData

from casadi_skin import Orbit, distance_from_orbit
from tests.studies.integration import monodromy_eigenvalues


def stability_claims(data: PaperData) -> Iterator[Claim]:
    """Sec. III with Figs. 5 and 6."""
    yield from _multipliers(data)
    yield from _weak_amplitude(data)
    yield from _vectors(data)
    yield from _kicks(data)
    yield from _projection()


def _multipliers(data: PaperData) -> Iterator[Claim]:
    branch = data.end_breather
    first = branch.changes[0]
    yield claim(
        "Fig. 5(a)", "j = 1, g = -1 is stable at weak amplitude", "stable", f"stable up to S = {first.value:.6f}",
        first.stable_before, "where the energy has a maximum along the family", first.error,
    )  # fmt: skip
    at_one, at_three = (branch.at(S=S).floquet() for S in (1.0, 3.0))
    yield claim(
        "Fig. 5(b)", "real instability at S = 1", "real",
        f"{at_one.unstable_real} real and {at_one.unstable_complex} complex multipliers outside, "
        f"largest {at_one.max_abs_multiplier:.9f}",
        at_one.unstable_real > 0 and at_one.unstable_complex == 0, error=TOLERANCE,
    )  # fmt: skip
    yield claim(
        "Fig. 5(c)", "real and complex instabilities at S = 3", "both",
        f"{at_three.unstable_real} real and {at_three.unstable_complex} complex multipliers outside, "
        f"largest {at_three.max_abs_multiplier:.9f}",
        at_three.unstable_real > 0 and at_three.unstable_complex > 0, error=TOLERANCE,
    )  # fmt: skip
    windows = ", ".join(f"{c.value:.4f} ({c.kind})" for c in branch.changes)
    yield claim(
        "Fig. 5(a)", "stable and unstable windows alternate at moderate amplitude", "alternating",
        f"{len(branch.changes)} changes to S = 3: {windows}", len(branch.changes) >= 3 and not branch.unresolved,
        "every change is found, however narrow its window", float(max(c.error for c in branch.changes)),
    )  # fmt: skip
    distance = _quadruples(branch.at(S=3.0))
    yield claim(
        "Sec. III", "with lambda also 1/lambda and their conjugates are multipliers", "quadruples",
        f"largest distance of a reciprocal or conjugate from the set at S = 3: {distance:.0e}", distance < 1e-4,
        "eigenvalues of the full 2N x 2N monodromy matrix, integrated over the period without using any symmetry; the "
        "trivial pair is split by the root of the integration error",
        1e-5,
    )  # fmt: skip


def _quadruples(orbit: Orbit) -> float:
    """How far 1/lambda and conj(lambda) are from the eigenvalues of the full-period matrix by DOP853 in the gauge."""
    values = monodromy_eigenvalues(orbit, gauge=True, rtol=1e-10, atol=1e-12)
    images = np.concatenate([1 / values, values.conj()])
    return float(np.max(np.min(np.abs(images[:, None] - values), axis=1)))


def _weak_amplitude(data: PaperData) -> Iterator[Claim]:
    onsets = {}
    for sign, families in (("+", data.hardening), ("-", data.softening)):
        for mode, branch in families.items():
            onsets[f"j = {mode}, g = {sign}1"] = branch.changes[0].value if branch.changes else np.inf
    early = {name: S for name, S in onsets.items() if S < 0.2}
    yield claim(
        "Sec. III, Fig. 3", "modes at weak amplitude are generally stable", "generally stable",
        "first loss of stability: "
        + "; ".join(f"{name}: {'none to S = 3' if np.isinf(S) else f'S = {S:.4f}'}" for name, S in onsets.items()),
        Verdict.IN_RANGE if early else Verdict.AGREES,
        f"all are stable as S -> 0, but {', '.join(early)} lose stability below S = 0.2, in narrow windows"
        if early
        else "",
        1e-8,
    )  # fmt: skip


def _vectors(data: PaperData) -> Iterator[Claim]:
    orbit = data.end_breather.at(S=1.0)
    vectors = np.abs(orbit.floquet_vectors()[:SITES])
    n = np.arange(1, SITES + 1)
    moving = vectors[:, np.max(vectors, axis=0) > 1e-8]
    centres = (n @ moving**2) / np.sum(moving**2, axis=0)
    share = float(np.mean(centres > (SITES + 1) / 2))
    yield claim(
        "Fig. 5(d)", "Floquet vectors have skin profiles at the favoured end", "all",
        f"{100 * share:.0f} per cent have their mean site in the right half; mean sites "
        f"{centres.min():.1f} to {centres.max():.1f}",
        share == 1.0, error=1e-6,
    )  # fmt: skip
    sine = np.sin(np.pi * n / SITES)
    right = np.sin(np.pi * n / (SITES + 1))
    s = data.chain(1.0).coupling
    L = np.diag(np.full(SITES, 3.0)) - s * (np.eye(SITES, k=1) + np.eye(SITES, k=-1))
    defects = [float(np.linalg.norm(L @ v - (v @ L @ v) / (v @ v) * v) / np.linalg.norm(v)) for v in (sine, right)]
    yield claim(
        "Sec. III", "in the resting region zeta_n is proportional to sin(n j pi/N)", "sin(n j pi/N)",
        f"residual {defects[0]:.1e} with N, {defects[1]:.0e} with N + 1", Verdict.MISPRINT,
        "fixed ends at n = 0 and N + 1 make it sin(n j pi/(N+1))", 1e-14,
    )  # fmt: skip


def _kicks(data: PaperData) -> Iterator[Claim]:
    orbit = data.softening_orbit
    norm = float(np.linalg.norm(orbit.profile))
    deviations = {site: distance_from_orbit(orbit, data.kicked(site)) for site in (SITES, 1)}
    yield claim(
        "Fig. 6(a)", "a kick of 0.005 at the right end leaves the mode coherent up to t = 40", "stable dynamics",
        f"largest deviation {100 * deviations[SITES].max():.2f} per cent of the mode's norm",
        deviations[SITES].max() < 0.05, error=1e-6,
    )  # fmt: skip
    growth = data.growth
    kick = np.zeros(2 * SITES)
    kick[0] = 1.0
    inside = growth.t <= 40.0
    kicked = float(10 ** growth.of(kick)[inside].max())
    bound = (SITES - 1) * np.arctanh(GAMMA) / np.log(10.0)
    yield claim(
        "Fig. 6(b)", "a kick of 0.005 at the left end destroys the linearly stable mode", "unstable dynamics",
        f"deviation reaches {100 * deviations[1].max():.0f} per cent of the mode's norm by t = 40",
        deviations[1].max() > 0.5,
        f"transient growth, not instability: the linear flow amplifies this kick {kicked:.0f} times, any perturbation "
        f"at most {10 ** growth.log10_bounded[inside].max():.0f} times by t = 40; r^((N-1)/2) = {10**bound:.0f}; the "
        f"kick times its growth is {KICK * kicked / norm:.1f} of the mode's norm",
        1e-6,
    )  # fmt: skip


def _projection() -> Iterator[Claim]:
    j = np.arange(1, SITES + 1)
    r = (1 + GAMMA) / (1 - GAMMA)
    right = r ** (j[:, None] / 2) * np.sin(np.outer(j, j) * np.pi / (SITES + 1))
    kick = np.zeros(SITES)
    kick[0] = KICK
    true = np.linalg.solve(right, kick)
    stated = 2 * KICK * r**-0.5 * np.sin(j * np.pi / (SITES + 1))
    ratio = stated / true
    normalised = true * np.sqrt((SITES + 1) / 2)  # of u and v divided by the root of sum v u = (N+1)/2
    yield claim(
        "Sec. III", "c_j = 2 delta r^(-1/2) sin(j pi/(N+1))", "formula",
        f"stated over true: {ratio.mean():.6f} for every j (spread {np.ptp(ratio):.0e})", Verdict.MISPRINT,
        "with u and v as printed the projection has the factor 1/(N+1) = 1/25, since sum v u = (N+1)/2; the "
        "bi-orthonormalization that the paper assumes, sum v u = 1, makes it "
        f"{float(np.mean(stated / normalised)):.2f} = sqrt(2 (N+1)) in place of 25", 1e-8,
    )  # fmt: skip
    spread = np.abs(true) / np.abs(true).max()
    yield claim(
        "Sec. III", "all modes are strongly excited: |c_j|/max |c_j| ~ 1", "~ 1",
        f"from {spread.min():.3f} (j = 1 and {SITES}) to 1; above 0.5 for {np.count_nonzero(spread > 0.5)} of {SITES}",
        Verdict.IN_RANGE,
        "of order one in the middle of the band, an eighth at its edges, where the mode j = 1 itself is", 1e-12,
    )  # fmt: skip
