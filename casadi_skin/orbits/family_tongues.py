"""Every change of stability of a family: the family's orbits and flow, given to the search for tongues."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.bvp.symmetry import symmetry_class
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.branch_sampler import OrbitSampler
from casadi_skin.orbits.multipliers import accelerations, on_all_sites
from casadi_skin.orbits.tools import FamilyTools
from casadi_skin.stability.find_changes import find_changes
from casadi_skin.stability.tongues import StabilityDiagram
from casadi_skin.threads import one_thread

ORBIT_TOLERANCE = 1e-12  # of the orbits along the family, whatever the tolerance of its points
FLOW_TOLERANCE = 1e-9  # of the norm of transition matrices; errors of multipliers are 10 to 1000 times smaller


def family_tongues(branch: Branch, flow_tolerance: float = FLOW_TOLERANCE) -> StabilityDiagram:
    """Every change of stability along a family, however narrow its window.

    The result depends on the way of the family, not on its points or their tolerance: orbits and transition matrices
    are computed anew, to tolerances of their own.

    Arguments:
        branch: the family.
        flow_tolerance: of the transition matrices, in norm; a smaller one decides narrower tongues.

    Returns:
        Changes of stability, tongues, and what is not decided or not resolved.
    """
    tools, points = branch.tools, [branch.start, *(orbit.point for orbit in branch.orbits)]
    if isinstance(tools.layout, CoreWithTail):
        points = [on_all_sites(tools, point) for point in points]
        tools = tools.whole
    request = replace(tools.request, tolerance=flow_tolerance)
    chain, flow = request.chain, FamilyTools(request).flow
    others = {k: chain.linear_frequency(k) for k in range(1, chain.sites + 1) if k != request.mode}
    with one_thread():
        sampler = OrbitSampler(
            tools.point_solver,
            points,
            flow,
            lambda states: accelerations(tools, states),
            request.S_of,
            ORBIT_TOLERANCE,
            symmetry_class(tools.model).value,
        )
        return find_changes(sampler, others)
