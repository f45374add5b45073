"""Every change of stability of a family: the family's orbits and flow, given to the search for tongues."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.branch_sampler import OrbitSampler
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.spectrum import linear_frequencies
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
    space = branch.space
    assert isinstance(space, Family)
    whole = space.whole
    points = [space.on_all_positions(point) for point in (branch.start, *(orbit.point for orbit in branch.orbits))]
    request, coordinates = replace(whole.request, tolerance=flow_tolerance), whole.coordinates
    frequencies = linear_frequencies(request.model, coordinates.parameters)
    others = {k + 1: float(w) for k, w in enumerate(frequencies) if k + 1 != coordinates.mode_number}
    with one_thread():
        sampler = OrbitSampler(
            whole.point_solver,
            points,
            Family(request).flow,
            whole.accelerations,
            request.S_of,
            ORBIT_TOLERANCE,
            whole.symmetry.value,
            coordinates.symplectic,
        )
        return find_changes(sampler, others)
