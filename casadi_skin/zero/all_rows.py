"""Second and third derivatives of all equations of a solution, those of its conditions and integrals among them."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_skin.zero.formulation import Formulation
from casadi_skin.zero.linearised import Linearised, Vector
from casadi_skin.zero.problem import Array


def full_derivative(linear: Linearised, *directions: Array) -> Array:
    """The second or third derivative of the equations in as many real directions, in the order of their rows."""
    return np.concatenate([linear.derivative(*directions), _of_ends(linear, directions), _of_means(linear, directions)])


def _of_ends(linear: Linearised, directions: tuple[Array, ...]) -> Array:
    """That of the conditions at the ends."""
    problem, count = linear.problem, _rows(linear)[0]
    if not count:
        return np.zeros(0)
    function = _along_ends(problem.formulation, count, len(directions))
    x = linear.z[: problem.states].reshape(problem.columns, -1)
    along = [part for v in directions for part in _parts(linear, v, [0, -1])]
    return np.array(function(x[0], x[-1], *problem.repeated(linear.z, 1), *along)).ravel()


def _of_means(linear: Linearised, directions: tuple[Array, ...]) -> Array:
    """That of the integrals."""
    problem, count = linear.problem, _rows(linear)[1]
    if not count:
        return np.zeros(0)
    stages = problem.stages.size
    function = _along_stages(problem.formulation, count, len(directions)).map(stages)
    starts = np.cumsum(problem.constants) - problem.constants
    places = (starts[:, None] + problem.constants[:, None] * problem.table.nodes).ravel()[None]
    x = linear.z[: problem.states].reshape(problem.columns, -1)[problem.stages].T
    along = []
    for v in directions:
        *states, scalars = _parts(linear, v, list(problem.stages))
        along += [np.array(states).T, np.tile(scalars[:, None], stages)]
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    found = np.array(function(places, x, *problem.repeated(linear.z, stages), *along))
    return np.asarray(found.reshape(count, stages) @ weights)


def _rows(linear: Linearised) -> tuple[int, int]:
    """Numbers of the solution's own conditions and integrals."""
    groups = (linear.statement.conditions, linear.statement.integrals)
    conditions, integrals = (sum(int(e.numel()) for e in group) for group in groups)
    return conditions, integrals


def _parts(linear: Linearised, v: Vector, columns: list[int]) -> list[Array]:
    """A direction in all components of the states at some columns, and in all scalars."""
    problem = linear.problem
    x = np.zeros((len(columns), problem.formulation.states))
    x[:, : linear.components] = v[: linear.states].reshape(problem.columns, -1)[columns]
    scalars = np.zeros(problem.size - problem.states)
    scalars[: v.size - linear.states] = v[linear.states :]
    return [*x, scalars]


@lru_cache(maxsize=16)
def _along_ends(formulation: Formulation, count: int, order: int) -> ca.Function:
    """Function (start, end, scalars, constants, directions in each of the first three) -> derivative in these."""
    return _directional(
        [*formulation.ends, formulation.scalars, formulation.constants], 0, formulation.conditions[:count], order
    )


@lru_cache(maxsize=16)
def _along_stages(formulation: Formulation, count: int, order: int) -> ca.Function:
    """Function (s, x, scalars, constants, directions in x, scalars) -> derivative of the leading integrands."""
    return _directional(
        [formulation.s, formulation.x, formulation.scalars, formulation.constants], 1, formulation.integrands[:count],
        order,
    )  # fmt: skip


def _directional(known: list[ca.SX | ca.MX], first: int, values: ca.SX | ca.MX, order: int) -> ca.Function:
    """The derivative of values in directions of the known symbols from the first to the last but one."""
    kind, directions = type(known[0]), []
    for k in range(order):
        along = [kind.sym(f"d{k}{i}", symbol.numel()) for i, symbol in enumerate(known[first:-1])]
        values = sum(
            (ca.jtimes(values, symbol, d) for symbol, d in zip(known[first:-1], along, strict=True)),
            kind.zeros(values.numel()),
        )
        directions += along
    return ca.Function("derivative", [*known, *directions], [ca.densify(values)])
