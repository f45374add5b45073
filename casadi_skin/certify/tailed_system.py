"""The equations of a chain's core with the linear tail that it is coupled to."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.certify.cosine_system import CosineSystem
from casadi_skin.certify.linear_tail import LinearTail
from casadi_skin.certify.model_terms import ball, system_of
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import FullChain


def tailed_system(coordinates: CoreWithTail, S: float, decimals: bool) -> CosineSystem:
    """The equations of the core, in the order of its sites, with the tail that they are coupled to."""
    chain, sites = coordinates.chain, coordinates.core.sites
    alone = FullChain(replace(chain, sites=sites), 1)
    if coordinates.declared is not None:
        lattice, values = coordinates.declared
        alone.declared = lattice.of_cells(sites), values
    core = system_of(alone, S, 2, decimals)
    weak, strong = sorted((core.forces[0][1,], core.forces[1][0,]))  # 1 - |gamma| and 1 + |gamma|
    ratio = ball(weak / strong)
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
        ball(weak * strong).sqrt(),
        ratio,
        abs(terms[inner, inner, inner]),
        scale[inner] ** 2,
    )
    return replace(system, tail=tail)
