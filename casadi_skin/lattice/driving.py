"""The period of the drives of a lattice."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import read_formula
from casadi_skin.lattice.equations import Equations
from casadi_skin.model.array_expressions import expression
from casadi_skin.model.formula import Name, Operation, Tree

SAME = 1e-12  # relative difference of frequencies that are the same but for rounding
ACCEPTED = "accepted: sines and cosines of t of one frequency, or with forcing_period"


def forcing_period_of(equations: Equations, given: str | None) -> ca.SX | None:
    """The period of the drives, None without any.

    Arguments:
        equations: of the lattice.
        given: a formula in parameters for the period; None where it is that of the sines and cosines of t.

    Raises:
        ValueError: there is a period given and no drive, or the drives have none that shows.
    """
    if not equations.driven:
        if given is not None:
            raise ValueError(f"forcing_period: given {given!r} without a drive; accepted: with a drive in t")
        return None
    if given is not None:
        formula = read_formula("forcing_period", given, tuple(equations.declaration.scalars))
        period = expression(formula, equations.symbols)
        (value,) = equations.at_nominal(period)
        if not 0 < value[0] < np.inf:
            raise ValueError(f"forcing_period: given {given!r}, which is {value[0]:g}; accepted: a finite number > 0")
        return period
    rates = list(_rates(equations))
    (values,) = equations.at_nominal(ca.vertcat(*rates))
    values = np.abs(values)
    if np.ptp(values) > SAME * np.max(values) or not np.all(np.isfinite(values)) or not np.max(values) > 0:
        words = " and ".join(f"{value:g}" for value in np.unique(values)[:3])
        raise ValueError(f"drive: given drives of frequencies {words}; {ACCEPTED}")
    return 2.0 * np.pi / ca.fabs(rates[0])


def _rates(equations: Equations) -> Iterator[ca.SX]:
    """The derivative with respect to t of the argument of every sine and cosine in the drives, in every cell."""
    t, declaration = ca.SX.sym("t"), equations.declaration
    for s in range(len(declaration.sites)):
        formula = declaration.formulas["site", s, "drive"]
        for argument in _arguments(formula.tree, f'site {s + 1} drive: given "{formula.text}"'):
            rates = ca.jacobian(expression(argument, equations.values(equations.cells) | {"t": t}), t)
            if ca.depends_on(rates, t):
                raise ValueError(f'site {s + 1} drive: given "{formula.text}"; {ACCEPTED}')
            yield from (rate for rate in ca.vertsplit(ca.densify(rates)) if not rate.is_zero())


def _arguments(tree: Tree, given: str) -> Iterator[Tree]:
    """Arguments of the sines and cosines; raises ValueError for t outside of them."""
    if isinstance(tree, Name) and tree.name == "t":
        raise ValueError(f"{given}; {ACCEPTED}")
    if not isinstance(tree, Operation):
        return
    if tree.kind in ("sin", "cos"):
        yield tree.parts[0]
        return
    for part in tree.parts:
        yield from _arguments(part, given)
