"""A time evolution as a table: columns and rows of dynamics.csv, variables of dynamics.nc."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.results.dataset import Cell, Variable, unique_names
from casadi_skin.zero.problem import Array


def known_energy(evolution: Evolution) -> Array | None:
    """The energy, shape (time,); None where the model declares none."""
    return evolution.energy if evolution.has_energy else None


def evolution_columns(evolution: Evolution) -> list[str]:
    """Columns of dynamics.csv: t, the energy where there is one, positions, or states of a model of first order."""
    shown = evolution.equations.positions or evolution.equations.size
    fixed = ["t"] if known_energy(evolution) is None else ["t", "energy"]
    return [*fixed, *unique_names(evolution.names[:shown], ("t", "energy"))]


def evolution_rows(evolution: Evolution) -> Iterator[dict[str, Cell]]:
    """Rows of dynamics.csv, one a time."""
    columns, energy = evolution_columns(evolution), known_energy(evolution)
    known = [evolution.t] if energy is None else [evolution.t, energy]
    table = np.column_stack([*known, evolution.states])
    for row in table[:, : len(columns)].tolist():
        yield dict(zip(columns, row, strict=True))


def evolution_variables(evolution: Evolution) -> list[Variable]:
    """Variables of dynamics.nc along the dimension `time`."""
    variables, energy = [Variable("t", ("time",), evolution.t, "time")], known_energy(evolution)
    if energy is not None:
        variables.append(Variable("energy", ("time",), energy, "the conserved quantity"))
    if evolution.equations.positions:
        return [
            *variables,
            Variable("displacements", ("time", "site"), evolution.displacements, "displacements y_n"),
            Variable("velocities", ("time", "site"), evolution.velocities, "velocities of y_n"),
        ]
    return [
        *variables,
        Variable("states", ("time", "state"), evolution.states, "states; names: state_name"),
        Variable("state_name", ("state",), np.array(evolution.names), "names along `state`"),
    ]
