"""A first mesh for solutions with layers: placed again and again at a fixed number of intervals until it has settled.

Collocation at Gauss points does not damp what it does not resolve: on a coarse uniform mesh a layer at an end shows
nowhere, one inside everywhere. A mesh that is graded towards both ends meets the former at once, and repeated
equidistribution (de Boor 1973; Ascher, Mattheij and Russell 1995, section 9.1) finds the latter.
"""

from __future__ import annotations

import numpy as np

from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import Correction
from casadi_skin.zero import mesh
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.stated_problem import BoundaryProblem, stated

UNRESOLVED_ERROR = 0.1  # relative error beyond which a first mesh has missed something
RESOLVED_ERROR = 1e-2  # a smaller one needs no finer mesh to be believed
MESH_SIZES = (40, 90, 200)
PLACEMENT_ROUNDS = 20
SETTLED_IMBALANCE = 1.2  # imbalance of a mesh that need not be placed again
SMALLEST_INTERVAL = 1e-8  # first interval of a graded mesh, of the whole


def converged_mesh(
    levels: Levels, problem: BoundaryProblem, first: Correction
) -> tuple[BoundaryProblem, Correction] | None:
    """The solution near a first one on a mesh that resolves it; None where it is resolved as it is, or nowhere."""
    z = first.z
    if _error(levels, problem, first) <= UNRESOLVED_ERROR:
        return None
    for resolution in [r for r in MESH_SIZES if r > problem.resolution]:
        target = stated(levels.problem(resolution))
        starts = (
            problem.transferred(target),
            target.with_constants(mesh.graded(resolution, SMALLEST_INTERVAL)),
        )
        found, errors = [], []
        for start in starts:
            solution = _placed(levels, problem, z, start)
            if solution is not None:
                found.append(solution)
                errors.append(_error(levels, *solution))
                if errors[-1] <= RESOLVED_ERROR:
                    break
        if min(errors, default=np.inf) <= UNRESOLVED_ERROR:
            return found[int(np.argmin(errors))]
    return None


def _placed(
    levels: Levels, problem: BoundaryProblem, z: Array, target: BoundaryProblem
) -> tuple[BoundaryProblem, Correction] | None:
    """The solution near z on a mesh placed until it has settled."""
    for _ in range(PLACEMENT_ROUNDS):
        correction = levels.corrector(target).correct(problem.prolong(z, target), target.parameter_row(), 0.0)
        if not correction.converged:
            return None
        problem, z = target, correction.z
        if problem.imbalance(z) <= SETTLED_IMBALANCE and _error(levels, problem, correction) <= UNRESOLVED_ERROR:
            return problem, correction
        target = problem.placed(z, problem)
    return problem, correction


def _error(levels: Levels, problem: BoundaryProblem, correction: Correction) -> float:
    try:
        return levels.near(problem, correction.z, RESOLVED_ERROR, correction.solve)[0].relative(1.0)
    except SingularError:
        return float(np.inf)
