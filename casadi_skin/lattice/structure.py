"""Structure of a lattice: gauge, energy, momentum, oddness, mirrors; each is checked at random points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.gauge import LARGEST, is_conserved, is_gradient, log_weights_of, site_energies
from casadi_skin.lattice.symmetries import is_odd, is_polynomial, keeps_momentum, mirrors_of
from casadi_skin.lattice.trials import trials_of


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
