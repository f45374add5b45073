"""Names of the quantities that cells of a scene may have, known before one is computed."""

from __future__ import annotations

import re

from casadi_skin.follow.rest_codimension_two import CUSP, TAKENS, ZERO_HOPF
from casadi_skin.follow.special_points import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.results.branch_quantities import FIXED as OF_BRANCHES
from casadi_skin.results.equilibria import FIXED as OF_EQUILIBRIA
from casadi_skin.results.family_quantities import FAMILY, FAMILY_ERRORS, FAMILY_PROOFS, FAMILY_STABILITY
from casadi_skin.runs.faults import SceneError, check_known
from casadi_skin.runs.map_grid import Grid
from casadi_skin.runs.request import Request

KINDS = (FOLD, HOPF, BRANCH_POINT, DOUBLING, TORUS, CUSP, TAKENS, ZERO_HOPF, "generalized hopf", "hopf-hopf")
OF_ALL = ("points", "end", "end_reason")
STABILITY = ("first_instability", "first_instability_error", "first_tongue", "unresolved", "changes")
LEFT_OUT = ("point", "requested", "special", "fold")  # marks of a place along a branch
SUFFIX = re.compile(r"_(j?\d+)$")  # of a family or a branch among several


def plain_kind(kind: str) -> str:
    """A kind of special point as part of a name."""
    return kind.replace(" ", "_").replace("-", "_")


def known_names(request: Request) -> tuple[str, ...]:
    """Names of quantities without the suffix that distinguishes several branches."""
    scene = request.scene
    if scene.search is not None:
        return ("objective", "optima", "end", "end_reason", "Omega", *FREE, *NAMED)
    if scene.family is not None:
        tables = (FAMILY, FAMILY_STABILITY, FAMILY_ERRORS, FAMILY_PROOFS)
        names = [quantity.name for table in tables for quantity in table]
        return (*names, "regime", "threshold", *STABILITY, *OF_ALL)
    states = request.equations.state_names
    special = [
        word for kind in map(plain_kind, KINDS) for word in (f"{kind}_count", f"first_{kind}", f"first_{kind}_error")
    ]
    extremes = [f"{name}_{end}" for name in request.ode.state_names for end in ("min", "max")]
    fixed = OF_EQUILIBRIA if scene.equilibrium is not None else OF_BRANCHES
    fixed = (*fixed, "energy") if scene.orbit is not None and request.ode.hamiltonian is not None else fixed
    found = (*request.parameters, *states, *extremes, *fixed, *STABILITY, *special, *OF_ALL)
    return tuple(name for name in dict.fromkeys(found) if name not in LEFT_OUT)


def check_quantities(request: Request, grid: Grid) -> None:
    """Raises SceneError for a quantity that [map] names and that no cell can have."""
    table = request.scene.map
    known = [name for name in known_names(request) if name not in [axis.name for axis in grid.axes]]
    for key in ("quantities", "watch"):
        for name in getattr(table, key) or ():
            if SUFFIX.sub("", name) not in known:
                check_known(f"[map] {key}", name, known)
    if table is not None and table.growth and "first_instability" not in known:
        raise SceneError("[map] growth: given without a quantity first_instability; accepted: beside a [family]")
