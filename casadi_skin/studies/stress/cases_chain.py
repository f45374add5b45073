"""Hard cases of the chain: gamma to 1 and back, sizes from 1 to 3000, alpha, modes that nearly meet."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from casadi_skin.lattice.chain import Chain
from casadi_skin.studies.stress.case import Case, Finding, Refusal
from casadi_skin.studies.stress.checks import (
    BY_DIGITS,
    BY_ELLIPTIC,
    BY_MIRROR,
    TOLERANCE,
    against_digits,
    against_duffing,
    against_first_order,
    at_S,
    chain_words,
    mirrored,
    orbit_at,
)

GAMMA, SIZE, ALPHA, MODES = "gamma", "number of sites", "alpha", "modes that nearly meet"
GAMMAS = (0.0, 1e-12, 0.9, 0.99, 0.999, 1.0 - 1e-9, 1.0)
SIZES = (1, 2, 3, 24, 200, 1000, 3000)


def _gamma_words(gamma: float) -> str:
    if not 0.999 < abs(gamma) < 1.0:
        return f"gamma = {gamma:g}"
    words = f"1 - {1.0 - abs(gamma):.0e}"
    return f"gamma = {words}" if gamma > 0 else f"gamma = -({words})"


def _tolerance(gamma: float) -> float:
    """What costs a second at most: the last digits of orbits of modes that nearly meet cost ten times that."""
    return TOLERANCE if gamma <= 0.999 or gamma == 1.0 else 10.0 * TOLERANCE


def gamma_cases() -> Iterator[Case]:
    """End modes of 24 sites at S = 1, gamma from 0 to 1, and the same mirrored."""
    for gamma in GAMMAS:
        for g, mode in ((1.0, 24), (-1.0, 1)):
            chain = Chain(24, 1.0, gamma, g)
            name, asked = f"{_gamma_words(gamma)}, g = {g:g}", f"{chain_words(chain, mode)}, S = 1"
            if gamma == 1.0:
                yield Case(GAMMA, name, asked, BY_ELLIPTIC, at_S(chain, mode, 1.0, against_duffing), quick=True)
            else:
                compute = at_S(chain, mode, 1.0, tolerance=_tolerance(gamma))
                yield Case(GAMMA, name, asked, BY_DIGITS, compute, quick=gamma in (0.0, 0.999))
            if gamma > 0:
                other = Chain(24, 1.0, -gamma, g)
                name, asked = f"{_gamma_words(-gamma)}, g = {g:g}", f"{chain_words(other, mode)}, S = 1"
                mirror = partial(mirrored, other, mode, 1.0, _tolerance(gamma))
                yield Case(GAMMA, name, asked, BY_MIRROR, mirror, quick=gamma in (0.9, 1.0))
    for gamma in (1.0, -1.0):
        chain = Chain(24, 1.0, gamma, 1.0)
        words = "only the family in which the edge site alone moves"
        yield Case(
            GAMMA, f"gamma = {gamma:g}, j = 12", f"{chain_words(chain, 12)}, S = 1", "is to be refused",
            at_S(chain, 12, 1.0), Refusal.EXPECTED, words, quick=True,
        )  # fmt: skip
    for beyond in (1.0 + 1e-15, -1.5, float("nan")):
        words = "finite" if beyond != beyond else "-1 <= gamma <= 1"
        yield Case(
            GAMMA, f"gamma = {beyond:.16g}", f"N = 24, gamma = {beyond:.16g}", "is to be refused",
            partial(_impossible, beyond), Refusal.EXPECTED, words, quick=True,
        )  # fmt: skip


def _impossible(gamma: float) -> Finding:
    chain = Chain(24, 1.0, gamma, 1.0)
    return Finding(f"{chain} was made", 0.0, 1.0)


def size_cases() -> Iterator[Case]:
    """End modes at S = 1, from one site to 3000; at gamma = 0.7 and 3000 sites r^N is above 10^2000."""
    for sites in SIZES:
        for gamma, g in ((0.25, -1.0), (0.7, 1.0))[sites == SIZES[-1] :]:
            mode = sites if g > 0 else 1
            chain = Chain(sites, 1.0, gamma, g)
            name, asked = f"N = {sites}, gamma = {gamma:g}", f"{chain_words(chain, mode)}, S = 1"
            quick = sites in (2, 24) or (sites == 200 and g > 0)
            if sites == 1:
                yield Case(SIZE, name, asked, BY_ELLIPTIC, at_S(chain, mode, 1.0, against_duffing), quick=True)
            else:
                compute = at_S(chain, mode, 1.0, tolerance=1e-12 if sites < 1000 else 1e-9)
                yield Case(SIZE, name, asked, BY_DIGITS, compute, quick=quick)


def alpha_cases() -> Iterator[Case]:
    """alpha from the bound at which a mode stops oscillating to 10^6."""
    for alpha, g, mode, S in (
        (0.0, 1.0, 24, 1.0),
        (0.0, -1.0, 1, 0.01),
        (1e-8, 1.0, 24, 1.0),
        (1e-8, -1.0, 1, 0.01),
        (1e6, 1.0, 24, 1.0),
        (1e6, -1.0, 1, 0.01),
        (-0.0787, 1.0, 24, 1.0),
        (-0.0787, -1.0, 1, 1e-3),
        (-3.9, 1.0, 24, 1.0),
    ):
        chain = Chain(24, alpha, 0.25, g)
        asked = f"{chain_words(chain, mode)}, S = {S:g}"
        yield Case(ALPHA, f"alpha = {alpha:g}, j = {mode}", asked, BY_DIGITS, at_S(chain, mode, S), quick=alpha < -3)
    for alpha, mode, bound in ((-0.0788, 1, "alpha > -0.0787781"), (-4.0, 24, "alpha > -3.92122")):
        chain = Chain(24, alpha, 0.25, 1.0)
        yield Case(
            ALPHA, f"alpha = {alpha:g}, j = {mode}", chain_words(chain, mode), "is to be refused",
            at_S(chain, mode, 1.0), Refusal.EXPECTED, bound, quick=True,
        )  # fmt: skip


def mode_cases() -> Iterator[Case]:
    """Modes in the middle of dense bands: of long chains, and near gamma = 1."""
    for sites, gamma, S, allowed in ((200, 0.25, 0.01, 1e-2), (1000, 0.25, 0.1, 1e-2), (1000, 0.7, 0.1, 1e-2)):
        chain, mode = Chain(sites, 1.0, gamma, 1.0), sites // 2
        name, asked = f"N = {sites}, gamma = {gamma:g}, j = {mode}", f"{chain_words(chain, mode)}, S = {S:g}"
        first = at_S(chain, mode, S, partial(against_first_order, allowed=allowed))
        yield Case(MODES, f"{name}: its own", asked, "multiple scales", first, quick=sites == 200)
        yield Case(MODES, name, asked, BY_DIGITS, at_S(chain, mode, S), quick=sites == 200)
    for gamma in (0.99, 0.999, 1.0 - 1e-9):
        for g in (1.0, -1.0):
            chain = Chain(24, 1.0, gamma, g)
            name, asked = f"{_gamma_words(gamma)}, j = 12, g = {g:g}", f"{chain_words(chain, 12)}, S = 1"
            near = gamma > 0.9999
            yield Case(
                MODES, name, asked, BY_DIGITS, at_S(chain, 12, 1.0), Refusal.ALLOWED if near else Refusal.NEVER,
                "S = " if near else "",
            )  # fmt: skip
    for sites in (200, 1000):
        chain = Chain(sites, 1.0, 0.25, -1.0)
        asked = f"{chain_words(chain, 1)}, S = 3"
        check = partial(_same_breather, chain)
        yield Case(MODES, f"N = {sites}: as N = 24", asked, "N = 24", check, quick=sites == 200)


def _same_breather(chain: Chain) -> Finding:
    """At S = 3 the end breather is so short that the chain's length does not matter."""
    orbit, short = orbit_at(chain, 1, 3.0), orbit_at(Chain(24, chain.alpha, chain.gamma, chain.g), 1, 3.0)
    exact = against_digits(short)
    off = abs(orbit.Omega - short.Omega) / short.Omega
    return Finding(f"S = 3: Omega = {orbit.Omega:.14g}", off + exact.error, 1e-12)
