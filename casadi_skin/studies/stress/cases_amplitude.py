"""Hard cases of the amplitude: tiny and huge S, the end of existence, g of any size, internal resonance."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.harmonics import harmonic_shares, third_harmonic_leads
from casadi_skin.studies.stress.case import Case, Finding, Refusal, RefusedError, relative
from casadi_skin.studies.stress.checks import (
    BY_DIGITS,
    BY_ELLIPTIC,
    BY_SCALING,
    BY_TIME,
    against_digits,
    against_duffing,
    at_S,
    chain_words,
    family,
    orbit_at,
    orbit_words,
    returning,
    scaled,
    shift_against_digits,
)
from casadi_skin.studies.stress.exact import exact_orbit

SMALL, LARGE, SIZE_OF_G, RESONANCE = "tiny S", "large S", "size of g", "internal resonance"
END_ALLOWED = 1e-6  # relative distance of a family's last orbit from the end of its existence
FIT_ALLOWED = 1e-6  # difference of two shares of harmonics where they are to be equal


def small_cases() -> Iterator[Case]:
    """The shift of the frequency where subtraction has no digits left."""
    for S in (1e-14, 1e-10, 1e-6):
        for sites, g, mode in ((24, 1.0, 24), (24, -1.0, 1), (24, -1.0, 12), (1000, -1.0, 1)):
            chain = Chain(sites, 1.0, 0.25, g)
            quick = sites == 24 and mode != 12
            name = f"S = {S:g}, N = {sites}, j = {mode}"
            compute = at_S(chain, mode, S, shift_against_digits)
            yield Case(SMALL, name, f"{chain_words(chain, mode)}, shift", BY_DIGITS, compute, quick=quick)


def large_cases() -> Iterator[Case]:
    """S to 10^4 where g > 0, and to the end of existence where g < 0."""
    for sites, mode, S in ((1, 1, 1e4), (24, 24, 1e2), (24, 24, 1e4), (24, 1, 1e4), (6, 3, 1e4), (3, 2, 1e4)):
        chain = Chain(sites, 1.0, 0.25, 1.0)
        asked, name = f"{chain_words(chain, mode)}, S = {S:g}", f"S = {S:g}, N = {sites}, j = {mode}"
        if sites == 1:
            yield Case(LARGE, name, asked, BY_ELLIPTIC, at_S(chain, mode, S, against_duffing), quick=True)
        else:
            compute = partial(_with_folds, chain, mode, S)
            yield Case(LARGE, name, asked, BY_DIGITS, compute, quick=sites == 3)
    chain = Chain(8, 0.0, 0.25, 1.0)
    compute = partial(_with_folds, chain, 1, 20.0)
    yield Case(LARGE, "S = 20, N = 8, alpha = 0, j = 1", f"{chain_words(chain, 1)}, S = 20", BY_DIGITS, compute)
    for sites in (1, 2):
        chain = Chain(sites, 1.0, 0.25, -1.0)
        asked = f"{chain_words(chain, 1)}, S = 10"
        yield Case(
            LARGE, f"g < 0, N = {sites}: where it ends", asked, "equilibrium", partial(_to_the_end, chain),
            Refusal.EXPECTED, "does not exist", quick=sites == 1,
        )  # fmt: skip
    chain = Chain(24, 1.0, 0.25, -1.0)
    yield Case(
        LARGE, "g < 0, N = 24, j = 24, S = 10", f"{chain_words(chain, 24)}, S = 10", BY_DIGITS, at_S(chain, 24, 10.0)
    )


def folds(branch: Branch) -> list[float]:
    """Values of S near which the family turns in S."""
    S = branch.S
    turned = np.flatnonzero(np.diff(S)[1:] * np.diff(S)[:-1] < 0) + 1
    return [float(S[k]) for k in turned]


def _with_folds(chain: Chain, mode: int, S: float) -> Finding:
    branch = family(chain, mode, S)
    if not branch.complete:
        raise RefusedError(branch.reason, against_digits(branch.orbits[-1]))
    finding, turns = against_digits(branch.at(S=S)), folds(branch)
    near = ", ".join(f"{turn:.4g}" for turn in turns[:4])
    words = f"{len(turns)} folds, near S = {near}{', ...' if len(turns) > 4 else ''}" if turns else "no folds"
    return Finding(f"{finding.got}; {words}", finding.error, finding.allowed)


def _to_the_end(chain: Chain) -> Finding:
    """The last orbit of the family begins near an equilibrium, from which the way takes for ever."""
    branch = family(chain, 1, 10.0, tolerance=1e-10)
    last = branch.orbits[-1]
    y = _equilibrium(chain, last.profile)
    S = float(y @ y)
    words = f"equilibrium at S = {S:.10g}; last orbit at {last.S:.10g}, Omega = {last.Omega:.3g}"
    finding = Finding(words, relative(last.S, S), END_ALLOWED)
    if branch.complete:
        return finding
    raise RefusedError(branch.reason, finding)


def _equilibrium(chain: Chain, y: Array) -> Array:
    """The solution of D y + g y^3 = 0 near y, by Newton's method in physical coordinates."""
    D = (2.0 + chain.alpha) * np.eye(chain.sites)
    D -= (1.0 + chain.gamma) * np.eye(chain.sites, k=-1) + (1.0 - chain.gamma) * np.eye(chain.sites, k=1)
    for _ in range(30):
        y = y - np.linalg.solve(D + np.diag(3.0 * chain.g * y**2), D @ y + chain.g * y**3)
    return y


def coupling_cases() -> Iterator[Case]:
    """g from 1e-8 to 1e8 in magnitude at the same g S."""
    for g in (1e-8, 1e8, -1e-8, -1e8, 1e-300, -1e300):
        chain, mode = Chain(24, 1.0, 0.25, g), 24 if g > 0 else 1
        S = 1.0 / abs(g)
        asked = f"{chain_words(chain, mode)}, S = {S:g}"
        yield Case(SIZE_OF_G, f"g = {g:g}", asked, BY_SCALING, partial(scaled, chain, mode, S), quick=abs(g) == 1e8)
    yield Case(
        SIZE_OF_G, "g = 0", "N = 24, g = 0, j = 1", "is to be refused", at_S(Chain(24, 1.0, 0.25, 0.0), 1, 1.0),
        Refusal.EXPECTED, "linear mode at every amplitude", quick=True,
    )  # fmt: skip


def resonance_cases() -> Iterator[Case]:
    """Families of mode 1 through the resonance of 3 Omega with the band."""
    for gamma, through in ((0.25, (3.0, 3.2, 4.0)), (0.7, (2.6, 2.8, 4.0))):
        chain = Chain(24, 1.0, gamma, -1.0)
        for S in through:
            name, asked = f"gamma = {gamma:g}, S = {S:g}", f"{chain_words(chain, 1)}, S = {S:g}"
            yield Case(RESONANCE, name, asked, BY_DIGITS, partial(_with_third, chain, S), quick=S in (2.8, 3.2))
        compute = partial(_takeover, chain)
        name = f"gamma = {gamma:g}: third leads"
        yield Case(RESONANCE, name, f"{chain_words(chain, 1)}, to S = 4", BY_DIGITS, compute, quick=gamma < 0.5)
        name, in_time = f"gamma = {gamma:g}, S = 4, in time", at_S(chain, 1, 4.0, returning)
        yield Case(RESONANCE, name, f"{chain_words(chain, 1)}, S = 4", BY_TIME, in_time)
    chain = Chain(24, 0.1, 0.25, -1.0)
    name = "alpha = 0.1: in the band from the start"
    yield Case(RESONANCE, name, f"{chain_words(chain, 1)}, S = 1", BY_DIGITS, partial(_with_third, chain, 1.0))


def _with_third(chain: Chain, S: float) -> Finding:
    orbit = orbit_at(chain, 1, S)
    finding = against_digits(orbit)
    return Finding(f"{finding.got}; third {harmonic_shares(orbit)[1]:.3g}", finding.error, finding.allowed)


def _takeover(chain: Chain) -> Finding:
    """Where the shares of first and third harmonic are equal, in the coefficients of 50 digits too."""
    orbit = third_harmonic_leads(family(chain, 1, 4.0))
    if orbit is None:
        return Finding("the third harmonic never leads", 1.0, FIT_ALLOWED)
    gauge = np.asarray(exact_orbit(orbit).coefficients[:, :2], dtype=float) / chain.rho[:, None]
    first, third = np.sum(gauge**2, axis=0)
    return Finding(f"the third harmonic leads from {orbit_words(orbit)}", relative(third, first), FIT_ALLOWED)
