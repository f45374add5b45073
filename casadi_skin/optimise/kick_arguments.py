"""Arguments of the search for the smallest kick, checked."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_name, number, short_repr, whole
from casadi_skin.zero.problem import Indices

NORMS = ("physical", "energy")
LEAST_DISTANCE = 1e-4
LONGEST = 100.0  # periods


def check(orbit: Orbit, time: float, distance: float, norm: str, starts: int, seed: int) -> None:
    """Raises TypeError or ValueError for arguments out of range or an orbit that is not linearly stable."""
    if not isinstance(orbit, Orbit) or not isinstance(orbit.model, Chain):
        raise TypeError(f"orbit: given {short_repr(orbit)}; accepted: an Orbit of a chain, such as branch.at(S=0.2)")
    chain = orbit.model
    if chain.infinite or abs(chain.gamma) == 1.0:
        raise ValueError(f"orbit: given sites = {chain.sites}, gamma = {chain.gamma!r}; accepted: finite, |gamma| < 1")
    if orbit.S <= 0:
        raise ValueError("orbit: given S = 0; accepted: a breather of S > 0")
    if not 0 < number("time", time, "a finite time > 0") <= LONGEST * orbit.period:
        raise ValueError(
            f"time: given {time!r}; accepted: above 0, up to {LONGEST:g} periods = {LONGEST * orbit.period:.6g}"
        )
    least = max(LEAST_DISTANCE, 1e3 * orbit.profile_error)
    if number("distance", distance, "a finite fraction of the breather") < least:
        raise ValueError(f"distance: given {distance!r}; accepted: from {least:.1e} on, what the orbit's error allows")
    check_name("norm", norm, NORMS)
    if norm == "energy" and not chain.alpha + 2.0 > 2.0 * chain.coupling * np.cos(np.pi / (chain.sites + 1)):
        raise ValueError("norm: given 'energy', which is not positive in this chain; accepted: physical")
    whole("starts", starts, 1)
    whole("seed", seed, 0)
    if not orbit.floquet().stable:
        largest = orbit.floquet().max_abs_multiplier
        raise ValueError(
            f"orbit: the breather is linearly unstable (largest multiplier {largest:.6g}); accepted: a stable one"
        )


def kicked_sites(orbit: Orbit, at: int | Iterable[int] | None) -> Indices:
    """Indices of the sites that may be kicked."""
    count = orbit.model.sites
    if at is None:
        return np.arange(count)
    refused = f"at: given {short_repr(at)}; accepted: one or more different sites 1..{count}"
    if isinstance(at, bool) or not isinstance(at, int | np.integer | list | tuple | range | np.ndarray):
        raise TypeError(refused)
    given = np.atleast_1d(np.asarray(at, dtype=object)).ravel().tolist()
    known = all(isinstance(n, int) and not isinstance(n, bool) and 1 <= n <= count for n in given)
    if not given or not known or len(set(given)) < len(given):
        raise ValueError(refused)
    return np.array(sorted(given)) - 1
