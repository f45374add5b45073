"""The hard cases, by theme: every parameter at its extremes, large multipliers, orbits in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch, third_harmonic_leads
from casadi_skin.lattice.chain import Chain
from casadi_skin.zero.problem import Array
from tests.studies import extreme_checks as checks
from tests.studies.exact import exact_orbit
from tests.studies.extreme_case import Case, Finding, RefusedError, relative
from tests.studies.extreme_checks import TOLERANCE, Check, Setup, against_digits

GAMMA, SIZE, ALPHA, MODES = "gamma", "number of sites", "alpha", "modes that nearly meet"
SMALL, LARGE, SIZE_OF_G, RESONANCE = "tiny S", "large S", "size of g", "internal resonance"
MULTIPLIERS, PHYSICAL = "multipliers", "physical coordinates"
GAMMAS = (0.0, 1e-12, 0.9, 0.99, 0.999, 1.0 - 1e-9, 1.0)
SIZES = (1, 2, 3, 24, 200, 1000, 3000)
END_ALLOWED = 1e-6  # relative distance of a family's last orbit from the end of its existence
SHARES_ALLOWED = 1e-6  # difference of two shares of harmonics where they are to be equal
LOOSER = 1e-10  # tolerance of orbits whose multipliers are judged


def all_cases() -> list[Case]:
    """Every case, by theme."""
    makers = (
        *(_gamma_cases, _size_cases, _alpha_cases, _mode_cases, _small_cases, _large_cases, _coupling_cases),
        *(_resonance_cases, _multiplier_cases, _physical_cases),
    )
    return [case for maker in makers for case in maker()]


def _case(
    theme: str,
    name: str,
    setup: Setup,
    check: Check = against_digits,
    asked: str = "",
    work: Callable[[Setup], Finding] | None = None,
    **options: Any,
) -> Case:
    """The orbit of a setup, checked; or other work on the setup, as a rule by the same means."""

    def compute() -> Finding:
        return check(setup.orbit(), setup) if work is None else work(setup)

    return Case(theme, name, f"{setup}, {asked or f'S = {setup.S:g}'}", checks.CHECKS[check], compute, **options)


def _refused(theme: str, name: str, asked: str, compute: Callable[[], object], words: str) -> Case:
    """A case that is to be refused in these words."""

    def finding() -> Finding:
        return Finding(str(compute()), 0.0, 1.0)

    return Case(theme, name, asked, "is to be refused", finding, words, quick=True)


# Parameters of the chain --------------------------------------------------------------------------------------------


def _gamma_words(gamma: float) -> str:
    if not 0.999 < abs(gamma) < 1.0:
        return f"gamma = {gamma:g}"
    words = f"1 - {1.0 - abs(gamma):.0e}"
    return f"gamma = {words}" if gamma > 0 else f"gamma = -({words})"


def _gamma_cases() -> Iterator[Case]:
    """End modes of 24 sites at S = 1, gamma from 0 to 1, and the same mirrored.

    Near gamma = 1 the last digits of orbits of modes that nearly meet cost ten times the time of all others.
    """
    for gamma in GAMMAS:
        tolerance = TOLERANCE if gamma <= 0.999 or gamma == 1.0 else 10.0 * TOLERANCE
        for g, mode in ((1.0, 24), (-1.0, 1)):
            setup, name = Setup(Chain(24, 1.0, gamma, g), mode, 1.0), f"{_gamma_words(gamma)}, g = {g:g}"
            if gamma == 1.0:
                yield _case(GAMMA, name, setup, checks.against_duffing, quick=True)
            else:
                yield _case(GAMMA, name, replace(setup, tolerance=tolerance), quick=gamma in (0.0, 0.999))
            if gamma > 0:
                mirrored = Setup(Chain(24, 1.0, -gamma, g), mode, 1.0, tolerance)
                name = f"{_gamma_words(-gamma)}, g = {g:g}"
                yield _case(GAMMA, name, mirrored, checks.against_mirror, quick=gamma in (0.9, 1.0))
    for gamma in (1.0, -1.0):
        setup, words = Setup(Chain(24, 1.0, gamma, 1.0), 12, 1.0), "in which the edge site alone moves, can be followed"
        yield _refused(GAMMA, f"gamma = {gamma:g}, j = 12", f"{setup}, S = 1", setup.orbit, words)
    for beyond in (1.0 + 1e-15, -1.5, float("nan")):
        name, words = f"gamma = {beyond:.16g}", "finite" if beyond != beyond else "-1 <= gamma <= 1"
        yield _refused(GAMMA, name, f"N = 24, {name}", partial(Chain, 24, 1.0, beyond, 1.0), words)


def _size_cases() -> Iterator[Case]:
    """End modes at S = 1, from one site to 3000; at gamma = 0.7 and 3000 sites r^N is above 10^2000."""
    for sites in SIZES:
        for gamma, g in ((0.25, -1.0), (0.7, 1.0))[sites == SIZES[-1] :]:
            tolerance = 1e-12 if sites < 1000 else 1e-9
            setup = Setup(Chain(sites, 1.0, gamma, g), sites if g > 0 else 1, 1.0, tolerance)
            check = checks.against_duffing if sites == 1 else against_digits
            quick = sites in (1, 2, 24) or (sites == 200 and g > 0)
            yield _case(SIZE, f"N = {sites}, gamma = {gamma:g}", setup, check, quick=quick)


def _alpha_cases() -> Iterator[Case]:
    """alpha from the bound at which a mode stops oscillating to 10^6."""
    ends = ((0.0, 0.01), (1e-8, 0.01), (1e6, 0.01), (-0.0787, 1e-3))
    both = [case for alpha, S in ends for case in ((alpha, 1.0, 24, 1.0), (alpha, -1.0, 1, S))]
    for alpha, g, mode, S in (*both, (-3.9, 1.0, 24, 1.0)):
        setup = Setup(Chain(24, alpha, 0.25, g), mode, S)
        yield _case(ALPHA, f"alpha = {alpha:g}, j = {mode}", setup, quick=alpha < -3)
    for alpha, mode, bound in ((-0.0788, 1, "alpha > -0.0787781"), (-4.0, 24, "alpha > -3.92122")):
        setup = Setup(Chain(24, alpha, 0.25, 1.0), mode, 1.0)
        yield _refused(ALPHA, f"alpha = {alpha:g}, j = {mode}", str(setup), setup.orbit, bound)


def _mode_cases() -> Iterator[Case]:
    """Modes in the middle of dense bands: of long chains, and near gamma = 1."""
    for sites, gamma, S in ((200, 0.25, 0.01), (1000, 0.25, 0.1), (1000, 0.7, 0.1)):
        setup = Setup(Chain(sites, 1.0, gamma, 1.0), sites // 2, S)
        name, quick = f"N = {sites}, gamma = {gamma:g}, j = {setup.mode}", sites == 200
        yield _case(MODES, f"{name}: its own", setup, checks.against_first_order, quick=quick)
        yield _case(MODES, name, setup, quick=quick)
    for gamma in (0.99, 0.999, 1.0 - 1e-9):
        for g in (1.0, -1.0):
            name, refusal = f"{_gamma_words(gamma)}, j = 12, g = {g:g}", "S = " if gamma > 0.9999 else ""
            yield _case(MODES, name, Setup(Chain(24, 1.0, gamma, g), 12, 1.0), refusal=refusal, may_hold=True)
    for sites in (200, 1000):
        setup = Setup(Chain(sites, 1.0, 0.25, -1.0), 1, 3.0)
        yield _case(MODES, f"N = {sites}: as N = 24", setup, checks.against_short_chain, quick=sites == 200)


# Amplitude ----------------------------------------------------------------------------------------------------------


def _small_cases() -> Iterator[Case]:
    """The shift of the frequency where subtraction has no digits left."""
    for S in (1e-14, 1e-10, 1e-6):
        for sites, g, mode in ((24, 1.0, 24), (24, -1.0, 1), (24, -1.0, 12), (1000, -1.0, 1)):
            setup, name = Setup(Chain(sites, 1.0, 0.25, g), mode, S), f"S = {S:g}, N = {sites}, j = {mode}"
            quick = sites == 24 and mode != 12
            yield _case(SMALL, name, setup, checks.shift_against_digits, "shift", quick=quick)


def _large_cases() -> Iterator[Case]:
    """S to 10^4 where g > 0, and to the end of existence where g < 0."""
    for sites, mode, S in ((1, 1, 1e4), (24, 24, 1e2), (24, 24, 1e4), (24, 1, 1e4), (6, 3, 1e4), (3, 2, 1e4)):
        setup, name = Setup(Chain(sites, 1.0, 0.25, 1.0), mode, S), f"S = {S:g}, N = {sites}, j = {mode}"
        if sites == 1:
            yield _case(LARGE, name, setup, checks.against_duffing, quick=True)
        else:
            yield _case(LARGE, name, setup, work=_with_folds, quick=sites == 3)
    yield _case(LARGE, "S = 20, N = 8, alpha = 0, j = 1", Setup(Chain(8, 0.0, 0.25, 1.0), 1, 20.0), work=_with_folds)
    for sites in (1, 2):
        setup = Setup(Chain(sites, 1.0, 0.25, -1.0), 1, 10.0, LOOSER)
        case = _case(LARGE, f"g < 0, N = {sites}: where it ends", setup, work=_to_the_end, refusal="does not exist")
        yield replace(case, check="equilibrium", quick=sites == 1)
    yield _case(LARGE, "g < 0, N = 24, j = 24, S = 10", Setup(Chain(24, 1.0, 0.25, -1.0), 24, 10.0))


def _folds(branch: Branch) -> list[float]:
    """Values of S near which the family turns in S."""
    S = branch.S
    turned = np.flatnonzero(np.diff(S)[1:] * np.diff(S)[:-1] < 0) + 1
    return [float(S[k]) for k in turned]


def _with_folds(setup: Setup) -> Finding:
    branch = setup.family()
    if not branch.complete:
        raise RefusedError(branch.reason, against_digits(branch.orbits[-1], setup))
    finding, turns = against_digits(branch.at(S=setup.S), setup), _folds(branch)
    near = ", ".join(f"{turn:.4g}" for turn in turns[:4])
    words = f"{len(turns)} folds, near S = {near}{', ...' if len(turns) > 4 else ''}" if turns else "no folds"
    return replace(finding, got=f"{finding.got}; {words}")


def _to_the_end(setup: Setup) -> Finding:
    """The last orbit of the family begins near an equilibrium, which it takes for ever to leave."""
    branch = setup.family()
    last = branch.orbits[-1]
    y = _equilibrium(setup.chain, last.profile)
    S = float(y @ y)
    words = f"equilibrium at S = {S:.10g}; last orbit at {last.S:.10g}, Omega = {last.Omega:.3g}"
    finding = Finding(words, relative(last.S, S), END_ALLOWED)
    if branch.complete:
        return finding
    raise RefusedError(branch.reason, finding)


def _equilibrium(chain: Chain, y: Array) -> Array:
    """The solution of D y + g y^3 = 0 near y, in physical coordinates."""
    from scipy.optimize import root

    D, g = chain.dynamical_matrix(), chain.g

    def residual(y: Array) -> tuple[Array, Array]:
        return D @ y + g * y**3, D + np.diag(3.0 * g * y**2)

    return np.asarray(root(residual, y, jac=True, tol=1e-15).x)


def _coupling_cases() -> Iterator[Case]:
    """g from 1e-8 to 1e8 in magnitude at the same g S."""
    for g in (1e-8, 1e8, -1e-8, -1e8, 1e-300, -1e300):
        setup = Setup(Chain(24, 1.0, 0.25, g), 24 if g > 0 else 1, 1.0 / abs(g))
        yield _case(SIZE_OF_G, f"g = {g:g}", setup, checks.against_scaled, quick=abs(g) == 1e8)
    none = Setup(Chain(24, 1.0, 0.25, 0.0), 1, 1.0)
    yield _refused(SIZE_OF_G, "g = 0", "N = 24, g = 0, j = 1", none.orbit, "linear mode at every amplitude")


def _resonance_cases() -> Iterator[Case]:
    """Families of mode 1 through the resonance of 3 Omega with the band."""
    for gamma, through in ((0.25, (3.0, 3.2, 4.0)), (0.7, (2.6, 2.8, 4.0))):
        setup = Setup(Chain(24, 1.0, gamma, -1.0), 1, 4.0)
        for S in through:
            name = f"gamma = {gamma:g}, S = {S:g}"
            yield _case(RESONANCE, name, replace(setup, S=S), checks.with_third_harmonic, quick=S in (2.8, 3.2))
        name = f"gamma = {gamma:g}: third leads"
        yield _case(RESONANCE, name, setup, asked="to S = 4", work=_takeover, quick=gamma < 0.5)
        yield _case(RESONANCE, f"gamma = {gamma:g}, S = 4, in time", setup, checks.returning)
    name, soft = "alpha = 0.1: in the band from the start", Setup(Chain(24, 0.1, 0.25, -1.0), 1, 1.0)
    yield _case(RESONANCE, name, soft, checks.with_third_harmonic)


def _takeover(setup: Setup) -> Finding:
    """The place of equal shares of first and third harmonic, in the coefficients of 50 digits too."""
    orbit = third_harmonic_leads(setup.family())
    if orbit is None:
        return Finding("the third harmonic never leads", 1.0, SHARES_ALLOWED)
    gauge = np.asarray(exact_orbit(orbit).scaled[:, :2], dtype=float)
    first, third = np.sum(gauge**2, axis=0)
    return Finding(f"the third harmonic leads from {checks.orbit_words(orbit)}", relative(third, first), SHARES_ALLOWED)


# Stability and time -------------------------------------------------------------------------------------------------


def _multiplier_cases() -> Iterator[Case]:
    """mu against a reference in long double, which a result may miss by no more than its own estimate."""
    softening = Chain(2, 1.0, 0.25, -1.0)
    for name, chain, mode, S in (
        ("2e7: N = 2, S = 3.6", softening, 1, 3.6),
        ("5e7: N = 2, S = 3.6941", softening, 1, 3.6941),
        ("6e4: N = 24, gamma = 0.7, S = 3.62", Chain(24, 1.0, 0.7, -1.0), 1, 3.62),
        ("in the band: N = 200, j = 1, S = 0.2", Chain(200, 1.0, 0.25, -1.0), 1, 0.2),
        ("in the band: N = 200, j = 100, S = 1", Chain(200, 1.0, 0.25, 1.0), 100, 1.0),
        ("gamma = 0.999, N = 24, S = 1", Chain(24, 1.0, 0.999, -1.0), 1, 1.0),
    ):
        setup = Setup(chain, mode, S, LOOSER)
        yield _case(MULTIPLIERS, name, setup, checks.against_long_double, quick=S == 3.6)
    for name, chain, mode, S in (
        ("lambda(M) = 1: N = 2, S = 2.6", softening, 1, 3.0),
        ("lambda(M) = -1: N = 3, S = 2.5", Chain(3, 1.0, 0.25, -1.0), 1, 3.0),
        ("collision: N = 3, S = 0.8", Chain(3, 1.0, 0.25, 1.0), 2, 2.0),
    ):
        setup = Setup(chain, mode, S, LOOSER)
        asked = "first change of stability"
        yield _case(MULTIPLIERS, name, setup, checks.against_long_double, asked, _at_first_change, quick=True)


def _at_first_change(setup: Setup) -> Finding:
    """The orbit where the stability changes, as near as it is located."""
    branch = setup.family(stability=True)
    change = branch.changes[0]
    finding = checks.against_long_double(branch.at(S=change.value), setup)
    return replace(finding, got=f"S = {change.value:.7g}, {change.kind}: {finding.got}")


def _physical_cases() -> Iterator[Case]:
    """Where physical coordinates can work too: orbits in time, multipliers of the whole period."""
    for sites, gamma, g, mode, S in (
        *((2, 0.25, -1.0, 1, 1.0), (3, 0.25, 1.0, 2, 5.0), (3, -0.9, 1.0, 3, 1.0)),
        *((8, 0.25, -1.0, 1, 1.0), (8, 0.5, 1.0, 8, 10.0)),
    ):
        setup = Setup(Chain(sites, 1.0, gamma, g), mode, S, LOOSER)
        name = f"N = {sites}, gamma = {gamma:g}, j = {mode}: multipliers"
        yield _case(PHYSICAL, name, setup, checks.against_physical, quick=sites < 8)
    for sites, g, mode, S in ((3, 1.0, 2, 5.0), (24, -1.0, 1, 3.0), (24, 1.0, 24, 100.0)):
        setup, name = Setup(Chain(sites, 1.0, 0.25, g), mode, S), f"N = {sites}, S = {S:g}, j = {mode}: comes back"
        yield _case(PHYSICAL, name, setup, checks.returning, quick=sites == 3)
    one_way = Setup(Chain(24, 1.0, 1.0, 1.0), 24, 1.0)

    def vectors() -> object:
        return one_way.orbit().floquet_vectors()

    yield _refused(PHYSICAL, "gamma = 1: Floquet vectors", str(one_way), vectors, "Jordan chains")
