"""Declared lattices that are the chain of the paper: they are solved in its coordinates, to the last digit alike."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.declaration import FIXED, Declaration
from casadi_skin.model.expressions import expression
from casadi_skin.model.polynomial import NotPolynomialError, polynomial_terms


def declared_chain(declaration: Declaration, autonomous: bool, values: Mapping[str, float]) -> Chain | None:
    """The chain that a lattice is at some values of its parameters.

    Arguments:
        declaration: of any lattice.
        autonomous: whether it has neither damping nor drive.
        values: of all its parameters, by name.

    Returns:
        The chain with the same forces; None for any other lattice.

    Raises:
        ValueError: a formula is not finite at these values.
    """
    one = len(declaration.sites) == len(declaration.bonds) == 1 and declaration.boundary == (FIXED,)
    if not one or not autonomous or declaration.differing:
        return None
    along = declaration.bonds[0].offset[0]
    mass, onsite = _powers(declaration, values, "site", "mass"), _powers(declaration, values, "site", "onsite")
    force = _powers(declaration, values, "bond", "force")
    gains = [_powers(declaration, values, "bond", f"gain {k}").get(0, 0.0) for k in (1, 2)]
    right, left = gains[::along] if abs(along) == 1 else (0.0, 0.0)
    if mass != {0: 1.0} or force != {1: 1.0} or not set(onsite) <= {1, 3}:
        return None
    tried = (*values.values(), *(-value for value in values.values()), 0.5 * (left - right))
    gamma = next((value for value in tried if (1 - value, 1 + value) == (right, left)), None)  # none is rounded
    if gamma is None or not abs(gamma) < 1:
        return None
    return Chain(declaration.size, onsite.get(1, 0.0), gamma, onsite.get(3, 0.0))


def _powers(declaration: Declaration, values: Mapping[str, float], kind: str, field: str) -> dict[int, float]:
    """Coefficients of a formula by the power of its variable; {-1: nan} where it is no polynomial."""
    x = ca.SX.sym("x")
    known = {name: ca.SX(value) for name, value in values.items()} | {"y": x, "d": x}
    try:
        terms = polynomial_terms(expression(declaration.formulas[kind, 0, field], known), x, ca.SX.sym("p"))
    except NotPolynomialError:
        return {-1: float("nan")}
    found = {term.degree: float(term.coefficients[0]) for term in terms}
    if not all(map(math.isfinite, found.values())):
        text = declaration.formulas[kind, 0, field].text
        given = f'{kind} 1 {field}: given "{text}", in which a value is not finite'
        raise ValueError(f"{given}; accepted: formulas and values of parameters that are finite")
    return found
