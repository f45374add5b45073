"""Symmetries of a lattice, each checked at random points: oddness, momentum, mirrors; whether forces are polynomial."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import INDICES
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.trials import SAME, Trial, field_of
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts


def is_odd(equations: Equations, trials: list[Trial]) -> bool:
    field = field_of(equations)
    for trial in trials:
        there = np.array(field(trial.y, trial.v, trial.t, trial.parameters))
        back = np.array(field(-trial.y, -trial.v, trial.t, trial.parameters))
        if equations.driven:  # the forces beside the drive
            rest = np.array(field(0 * trial.y, 0 * trial.v, trial.t, trial.parameters))
            there, back = there - rest, back - rest
        if not np.max(np.abs(there + back)) <= SAME * np.max(np.abs(there)):
            return False
    return True


def keeps_momentum(equations: Equations, trials: list[Trial]) -> bool:
    """Whether the weighted forces add up to zero; in a lattice without gauge envelope."""
    field = field_of(equations)
    for trial in trials:
        if np.any(trial.gains[:, 0] != trial.gains[:, 1]):
            return False
        forces = trial.masses * np.array(field(trial.y, trial.v, trial.t, trial.parameters)).ravel()
        if not abs(forces.sum()) <= SAME * np.sum(np.abs(forces)):
            return False
    return True


def mirrors_of(equations: Equations, trials: list[Trial]) -> tuple[int, ...]:
    """Directions along which the mirrored lattice, with the sites of a cell in reversed order, is the same."""
    declaration, field = equations.declaration, field_of(equations)
    numbers = np.arange(declaration.size).reshape(*declaration.cells, len(declaration.sites))
    found = []
    for k in range(len(declaration.cells)):
        order = np.flip(np.flip(numbers, axis=k), axis=-1).ravel()
        holds = True
        for trial in trials:
            there = np.array(field(trial.y, trial.v, trial.t, trial.parameters)).ravel()
            image = np.array(field(trial.y[order], trial.v[order], trial.t, trial.parameters)).ravel()
            holds = holds and bool(np.max(np.abs(image - there[order])) <= SAME * np.max(np.abs(there)))
        if holds:
            found.append(k + 1)
    return tuple(found)


def is_polynomial(equations: Equations) -> bool:
    """Whether all forces are polynomials of positions and velocities, formula by formula."""
    declaration = equations.declaration
    for (kind, number, field), formula in declaration.formulas.items():
        varying = {*INDICES, *declaration.by_cell} & set(formula.names)
        x = ca.SX.sym("x", 2 if field == "damping" else 1)
        variables = {"y": x[0], "d": x[0], "v": x[-1], "t": ca.SX(0)}
        found = equations.at(kind, number, field, equations.cells if varying else equations.cells[:1], **variables)
        try:
            homogeneous_parts(ca.substitute(found, equations.parameters, ca.DM(equations.nominal)), x)
        except (NotPolynomialError, ValueError):
            return False
    return True
