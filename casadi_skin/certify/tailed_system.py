"""The equations of a chain's core with the linear tail that it is coupled to."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.certify.cosine_system import CosineSystem
from casadi_skin.certify.linear_tail import LinearTail
from casadi_skin.certify.model_terms import ball, exact, system_of
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import FullChain


def tailed_system(coordinates: CoreWithTail, S: float, decimals: bool) -> CosineSystem:
    """The equations of the core, in the order of its sites, with the tail that they are coupled to."""
    chain, sites = coordinates.chain, coordinates.core.sites
    core = system_of(FullChain(replace(chain, sites=sites), 1), S, 2, decimals)
    gamma = abs(exact(chain.gamma, decimals))
    ratio = ball((1 - gamma) / (1 + gamma))
    inner = 0 if chain.gamma > 0 else sites - 1
    unit = core.scale[sites - 1 - inner]
    scale = [unit * ratio.sqrt() ** (sites - 1 - abs(n - inner)) for n in range(sites)]
    system = replace(core, scale=scale)
    terms = dict(system.scaled(inner))
    tail = LinearTail(
        inner,
        int(coordinates.output_sites[0]),
        None if chain.infinite else int(chain.sites) - sites,
        -terms[inner,],
        ball(1 - gamma**2).sqrt(),
        ratio,
        abs(terms[inner, inner, inner]),
        scale[inner] ** 2,
    )
    return replace(system, tail=tail)
