"""Structure of a lattice: gauge, energy, momentum, oddness, mirrors; each is checked at random points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import INDICES, Array
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.gauge import LARGEST, is_conserved, is_gradient, log_weights_of, site_energies
from casadi_skin.lattice.trials import SAME, Trial, field_of, trials_of
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts

# Symmetries of a lattice, each checked at random points: oddness, momentum, mirrors; whether forces are polynomial ----


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


@dataclass(frozen=True, eq=False)
class Structure:
    """Properties of a lattice.

    Attributes:
        log_weights: logarithms of weights c_i > 0 with c_i gain_i = c_j gain_j on every bond, the smallest 1 in each
            connected part, shape (sites,): in positions scaled by their square roots the forces are a gradient. None
            where the gains of some loop do not agree.
        energy: sum of c (mass v^2/2 + onsite potential) + sum of c gain (potential of bonds), in the symbols of the
            model; None where there is none, or a force has no antiderivative that is known.
        energies: of the sites, whose sum is the energy: half of a bond's belongs to each of its ends. Without a gauge
            weights are 1 and gains their mean; None where a force has no antiderivative that is known.
        odd: whether the forces change sign with the positions.
        polynomial: whether the forces are polynomials of the positions.
        momentum: whether sum of c mass v is conserved.
        mirrors: directions, from 1, that the lattice may be mirrored along.
        damped, driven: whether velocities and time enter the forces.
    """

    log_weights: Array | None
    energy: ca.SX | None
    energies: ca.SX | None
    odd: bool
    polynomial: bool
    momentum: bool
    mirrors: tuple[int, ...]
    damped: bool
    driven: bool

    @property
    def hamiltonian(self) -> bool:
        """Whether the flow is Hamiltonian in scaled positions."""
        return self.log_weights is not None and self.reversible

    @property
    def reversible(self) -> bool:
        """Whether time may be reversed: there is neither damping nor drive."""
        return not (self.damped or self.driven)

    def lines(self) -> list[tuple[str, str]]:
        """Pairs (subject, words) for people."""
        return [
            ("gauge", self._gauge()),
            ("flow", self._flow()),
            ("forces", f"{'polynomial' if self.polynomial else 'not polynomial'}, {'odd' if self.odd else 'not odd'}"),
            ("conserved", self._conserved()),
            ("mirrors", f"along direction {' and '.join(map(str, self.mirrors))}" if self.mirrors else "none"),
        ]

    def _gauge(self) -> str:
        if self.log_weights is None:
            return "none: the gains around a loop of bonds do not agree; digits may be lost where bonds lean one way"
        span = 0.5 * float(np.max(self.log_weights))
        return "none needed: bonds act alike both ways" if span == 0 else (
            f"a diagonal one; displacements lean by a factor of up to {np.exp(min(span, 700.0)):.3g}")  # fmt: skip

    def _flow(self) -> str:
        if not self.reversible:
            return " and ".join(w for w, holds in (("damped", self.damped), ("driven", self.driven)) if holds)
        if self.hamiltonian:
            return "Hamiltonian and reversible"
        return "reversible, and Hamiltonian in no diagonal gauge: multipliers have no Krein signatures"

    def _conserved(self) -> str:
        found = ["energy"] if self.energy is not None else []
        if self.hamiltonian and self.energy is None:
            found.append("an energy that is not written, for a force has no antiderivative that is known")
        return ", ".join([*found, *(["momentum"] if self.momentum else [])]) or "nothing that is known"


@np.errstate(invalid="ignore", over="ignore", divide="ignore")  # values that are not finite hold nowhere
def structure_of(equations: Equations) -> Structure:
    """Properties of a lattice, checked at random positions and parameters near the declared ones."""
    trials = list(trials_of(equations))
    log_weights, scale = log_weights_of(equations, trials)
    if log_weights is not None and equations.autonomous and not is_gradient(equations, trials):
        log_weights = None
    energies, energy = site_energies(equations, log_weights, scale), None
    if energies is not None and log_weights is not None and equations.autonomous:
        total = ca.sum1(energies)
        energy = (
            total if np.max(log_weights) <= LARGEST and is_conserved(equations, total, log_weights, trials) else None
        )
    return Structure(
        log_weights, energy, energies, is_odd(equations, trials), is_polynomial(equations),
        log_weights is not None and equations.autonomous and keeps_momentum(equations, trials),
        mirrors_of(equations, trials), equations.damped, equations.driven,
    )  # fmt: skip
