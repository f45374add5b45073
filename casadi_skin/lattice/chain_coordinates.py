"""Which coordinates a family of a chain is solved in, and why others are refused."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from casadi_skin.lattice.chain import FIRST, LAST, Chain
from casadi_skin.lattice.full_chain import EdgeSite, FullChain
from casadi_skin.model.methods import PAYS_FROM, TRIGONOMETRIC
from casadi_skin.zero.model_coordinates import check_harmonics

if TYPE_CHECKING:
    from casadi_skin.zero.family import Coordinates, Method

NARROWEST_BAND = 1e-10  # of its squared frequency, in which doubles distinguish modes; measured
NEGLIGIBLE_CUBIC_RATIO = 1e-16  # of the cubic term: the part that the tail may leave out
TAIL_PAYS_FACTOR = 8  # times the core's sites from which on the elimination of the tail is cheaper
LONGEST_CORE = 5000


def chain_coordinates(chain: Chain, mode: int | str, amplitude_max: float, method: Method) -> Coordinates:
    """Coordinates of the family that grows from a linear mode to S = `amplitude_max`.

    Every site is an unknown; at |gamma| = 1 the edge site alone; and of a long chain the nonlinear core at its edge
    where the elimination of its linear tail is requested, or pays and `method.tail` leaves it open. Raises
    ValueError, naming the argument, for a chain or a mode without such a family.
    """
    number = chain.mode_number(mode)
    _check(chain, number)
    if abs(chain.gamma) == 1.0:
        return EdgeSite(chain, number)
    sites = core_sites(chain, amplitude_max)
    obstacle = _obstacle(chain, number, sites, method)
    if obstacle and (method.tail == "eliminated" or chain.infinite):
        given = "an infinite chain" if chain.infinite else '"eliminated"'
        raise ValueError(f"{'sites' if chain.infinite else 'tail'}: given {given}; accepted: {obstacle}")
    if method.tail == "full" and chain.infinite:
        raise ValueError('tail: given "full" with an infinite chain; accepted: eliminated')
    cut = method.stability_sites
    if cut is not None and (obstacle or not sites <= cut <= chain.sites):
        accepted = (
            f"with {obstacle}"
            if obstacle
            else f"{sites} to {chain.sites}: so many sites are nonlinear, and so many there are"
        )
        raise ValueError(f"stability_sites: given {cut}; accepted: {accepted}")
    eliminated = method.tail == "eliminated" or chain.infinite or cut is not None
    if method.tail is None and not obstacle:
        eliminated = eliminated or chain.sites >= max(PAYS_FROM, TAIL_PAYS_FACTOR * sites)
    if not eliminated:
        check_harmonics(chain.linear_spectrum().squares, number, repr(chain), odd=True)
        return FullChain(chain, number)
    from casadi_skin.lattice.core_with_tail import LongChain  # here: short chains do not need it

    return LongChain(chain, sites, number, amplitude_max, cut)


def core_sites(chain: Chain, amplitude_max: float) -> int:
    """Number of sites at the edge outside of which the cubic term is below round-off, counted to LONGEST_CORE."""
    reach = max(1.0, abs(chain.g) * amplitude_max)
    decay, sites = 2.0 * math.atanh(min(abs(chain.gamma), 1.0 - 1e-16)), 2
    while sites <= LONGEST_CORE and sites * decay < 2.0 * math.log(sites + 1) + math.log(
        reach / NEGLIGIBLE_CUBIC_RATIO
    ):
        sites += max(1, sites // 64)
    return sites


def _check(chain: Chain, number: int) -> None:
    """Raises ValueError where the chain has no family of this mode that doubles can follow."""
    if chain.g == 0:
        raise ValueError("g: given 0; accepted: not 0 (the family is the linear mode at every amplitude)")
    square = chain.linear_frequency(number) ** 2
    if chain.sites > 1 and 0.0 < 4.0 * chain.coupling < NARROWEST_BAND * square:
        raise ValueError(
            f"alpha: given {chain.alpha!r}, beside which the band is {4 * chain.coupling / square:.0e} wide:"
            f" its modes are the same in doubles; accepted: alpha up to {4.0 * chain.coupling / NARROWEST_BAND:.3g}"
        )
    edge = chain.sites if chain.g > 0 else 1
    if abs(chain.gamma) == 1.0 and number != edge:
        raise ValueError(
            f"mode: given {number}; accepted at |gamma| = 1 with g = {chain.g:g}: {edge} (all frequencies "
            "meet, and only the family in which the edge site alone moves exists in the gauge)"
        )


def _obstacle(chain: Chain, number: int, sites: int, method: Method) -> str:
    """Condition that keeps the tail from being eliminated; empty where it can be."""
    if number != chain.mode_number(LAST if chain.g > 0 else FIRST):
        return "the highest mode with g > 0, or the lowest with g < 0 (others have no limit for long chains)"
    if not 0.0 < abs(chain.gamma) < 1.0:
        return "0 < |gamma| < 1, where a tail exists and is linear"
    if method.transcription not in (None, TRIGONOMETRIC):
        return "transcription trigonometric"
    if sites > LONGEST_CORE:
        return f"a gamma at which fewer than {LONGEST_CORE} sites are nonlinear"
    if sites + 2 > chain.sites:
        return f"more than {sites + 2} sites: so many are nonlinear at this gamma"
    if chain.g < 0 and 9.0 * chain.band()[0] <= chain.band()[1]:
        return "an alpha so large that three times the lowest frequency lies above the band"
    return ""
