"""Hard cases of multipliers, and of orbits in time: very large, very close to 1, at collisions, in the band."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.studies.calibration.cases import reference_of
from casadi_skin.studies.calibration.reference import paired, reference_mu
from casadi_skin.studies.stress.case import Case, Finding, Refusal
from casadi_skin.studies.stress.checks import BY_TIME, at_S, chain_words, family, orbit_at, returning
from casadi_skin.studies.stress.flow import farthest, physical_multipliers

MULTIPLIERS, PHYSICAL = "multipliers", "physical coordinates"
BY_LONG_DOUBLE = "long double"
TIME_ALLOWED = 1e-8  # relative difference of multipliers from those of the physical full-period matrix
TOLERANCE = 1e-10  # an estimated error above it says that the tolerance is not reached


def multiplier_cases() -> Iterator[Case]:
    """mu against a reference in long double, which a result may miss by no more than its own estimate."""
    softening, hardening = Chain(2, 1.0, 0.25, -1.0), Chain(3, 1.0, 0.25, 1.0)
    for name, chain, mode, S, quick in (
        ("2e7: N = 2, S = 3.6", softening, 1, 3.6, True),
        ("5e7: N = 2, S = 3.6941", softening, 1, 3.6941, False),
        ("6e4: N = 24, gamma = 0.7, S = 3.62", Chain(24, 1.0, 0.7, -1.0), 1, 3.62, False),
        ("in the band: N = 200, j = 1, S = 0.2", Chain(200, 1.0, 0.25, -1.0), 1, 0.2, False),
        ("in the band: N = 200, j = 100, S = 1", Chain(200, 1.0, 0.25, 1.0), 100, 1.0, False),
        ("gamma = 0.999, N = 24, S = 1", Chain(24, 1.0, 0.999, -1.0), 1, 1.0, False),
    ):
        asked = f"{chain_words(chain, mode)}, S = {S:g}"
        compute = at_S(chain, mode, S, against_long_double, TOLERANCE)
        yield Case(MULTIPLIERS, name, asked, BY_LONG_DOUBLE, compute, quick=quick)
    for name, chain, mode, S in (
        ("lambda(M) = 1: N = 2, S = 2.6", softening, 1, 3.0),
        ("lambda(M) = -1: N = 3, S = 2.5", Chain(3, 1.0, 0.25, -1.0), 1, 3.0),
        ("collision: N = 3, S = 0.8", hardening, 2, 2.0),
    ):
        compute = partial(_at_first_change, chain, mode, S)
        asked = f"{chain_words(chain, mode)}, first change of stability"
        yield Case(MULTIPLIERS, name, asked, BY_LONG_DOUBLE, compute, quick=True)


def _at_first_change(chain: Chain, mode: int, S: float) -> Finding:
    """The orbit where the stability changes, as near as it is located."""
    branch = family(chain, mode, S, TOLERANCE, stability=True)
    change = branch.changes[0]
    finding = against_long_double(branch.at(S=change.S))
    return Finding(f"S = {change.S:.7g}, {change.kind}: {finding.got}", finding.error, finding.allowed)


def against_long_double(orbit: Orbit) -> Finding:
    """Each mu against the reference; what is allowed is the estimate of the mu that uses most of its own."""
    known, (mu, _) = orbit.floquet(), reference_mu(reference_of(orbit))
    size = np.maximum(1.0, np.abs(known.mu))
    off = np.abs(known.mu - paired(known.mu.astype(np.clongdouble), mu)).astype(float) / size
    estimates = known.mu_error / size
    worst = int(np.argmax(off / estimates))
    largest = known.max_abs_multiplier
    relative_error = known.error / largest
    flag = ", flagged" if max(relative_error, float(np.max(estimates))) > TOLERANCE else ""
    words = f"max |multiplier| = {largest:.10g}, estimated to {relative_error:.0e}{flag}"
    return Finding(words, float(off[worst]), float(estimates[worst]))


def physical_cases() -> Iterator[Case]:
    """Where physical coordinates can work too: orbits in time, multipliers of the whole period."""
    for sites, gamma, g, mode, S, quick in (
        (2, 0.25, -1.0, 1, 1.0, True),
        (3, 0.25, 1.0, 2, 5.0, True),
        (3, -0.9, 1.0, 3, 1.0, True),
        (8, 0.25, -1.0, 1, 1.0, False),
        (8, 0.5, 1.0, 8, 10.0, False),
    ):
        chain = Chain(sites, 1.0, gamma, g)
        asked, name = f"{chain_words(chain, mode)}, S = {S:g}", f"N = {sites}, gamma = {gamma:g}, j = {mode}"
        compute = at_S(chain, mode, S, against_physical, TOLERANCE)
        yield Case(PHYSICAL, f"{name}: multipliers", asked, BY_TIME, compute, quick=quick)
    for sites, gamma, g, mode, S in ((3, 0.25, 1.0, 2, 5.0), (24, 0.25, -1.0, 1, 3.0), (24, 0.25, 1.0, 24, 100.0)):
        chain = Chain(sites, 1.0, gamma, g)
        asked, name = f"{chain_words(chain, mode)}, S = {S:g}", f"N = {sites}, S = {S:g}, j = {mode}"
        compute = at_S(chain, mode, S, returning)
        yield Case(PHYSICAL, f"{name}: comes back", asked, BY_TIME, compute, quick=sites == 3)
    chain = Chain(24, 1.0, 1.0, 1.0)
    yield Case(
        PHYSICAL, "gamma = 1: Floquet vectors", chain_words(chain, 24), "is to be refused", partial(_vectors, chain),
        Refusal.EXPECTED, "Jordan chains", quick=True,
    )  # fmt: skip


def against_physical(orbit: Orbit) -> Finding:
    """Multipliers but the trivial pair, which the physical matrix splits by the root of its errors."""
    known, found = orbit.floquet(), physical_multipliers(orbit)
    rest = found[np.argsort(np.abs(found - 1.0))[2:]]
    off = farthest(known.multipliers[2:], rest)
    return Finding(f"max |multiplier| = {known.max_abs_multiplier:.10g}", float(np.max(off)), TIME_ALLOWED)


def _vectors(chain: Chain) -> Finding:
    shape = orbit_at(chain, 24, 1.0).floquet_vectors().shape
    return Finding(f"vectors of shape {shape}", 0.0, 1.0)
