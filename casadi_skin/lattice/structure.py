"""What a lattice shows of itself: gauge, energy, momentum, oddness, mirrors; each is checked at random points."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import Array, Link
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.expressions import antiderivative
from casadi_skin.models.polynomial import NotPolynomialError, homogeneous_parts

SAME = 1e-12  # relative difference of values that are the same but for rounding, per site
TRIALS = 3  # random points
LARGEST = 600.0  # logarithm of a weight of the energy that is still a double when squared displacements multiply it
AMPLITUDES = (1.0, 0.1, 0.01)  # of random positions: the first at which all forces are finite
SPREAD = 0.1  # relative change of parameters at random points: what holds at the declared values alone is not declared


@dataclass(frozen=True, eq=False)
class Structure:
    """What holds of a lattice.

    Attributes:
        log_weights: logarithms of weights c_i > 0 with c_i gain_i = c_j gain_j on every bond, the smallest 1 in each
            connected part, shape (sites,): in positions scaled by their square roots the forces are a gradient. None
            where the gains of some loop do not agree.
        energy: sum of c (mass v^2/2 + onsite potential) + sum of c gain (potential of bonds), in the symbols of the
            model; None where there is none, or a force has no antiderivative that is known.
        odd: whether the forces change sign with the positions.
        polynomial: whether the forces are polynomials of the positions.
        momentum: whether sum of c mass v is conserved.
        mirrors: directions, from 1, that the lattice may be mirrored along.
        damped, driven: whether velocities and time enter the forces.
    """

    log_weights: Array | None
    energy: ca.SX | None
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


@np.errstate(invalid="ignore", over="ignore", divide="ignore")  # what is not finite holds nowhere
def structure_of(equations: Equations) -> Structure:
    """What holds of a lattice, checked at random positions and parameters near the declared ones."""
    trials = list(_trials(equations))
    log_weights, scale = _log_weights(equations, trials)
    if log_weights is not None and equations.autonomous and not _is_gradient(equations, trials):
        log_weights = None
    energy = _energy(equations, log_weights, scale)
    return Structure(
        log_weights, energy, _is_odd(equations, trials), _is_polynomial(equations),
        log_weights is not None and equations.autonomous and _keeps_momentum(equations, trials),
        _mirrors(equations, trials), equations.damped, equations.driven,
    )  # fmt: skip


@dataclass(frozen=True)
class _Trial:
    """Random parameters, their gains and masses, and a random state with unit sizes."""

    parameters: Array
    gains: Array
    masses: Array
    y: Array
    v: Array
    t: float


def _trials(equations: Equations) -> Iterator[_Trial]:
    """The declared parameters, then others near them."""
    generator, nominal = np.random.default_rng(0), np.array(equations.nominal)
    gains = [gain for link in equations.links for gain in equations.gains(link)]
    evaluate = ca.Function(
        "f", [equations.parameters], [ca.vertcat(ca.SX(0, 1), *gains), ca.vertcat(*equations.masses)]
    )
    accelerations = _field(equations)
    for k in range(TRIALS):
        parameters = nominal * (1.0 + (SPREAD * generator.uniform(-1, 1, nominal.size) if k else 0.0))
        found = [np.array(value).ravel() for value in evaluate(parameters)]
        y, v, t = (
            generator.normal(size=equations.y.numel()),
            generator.normal(size=equations.y.numel()),
            generator.normal(),
        )
        for amplitude in AMPLITUDES:
            if np.all(np.isfinite(np.array(accelerations(amplitude * y, v, t, parameters)))):
                break
        yield _Trial(parameters, found[0].reshape(-1, 2), found[1], amplitude * y, v, t)


def _field(equations: Equations) -> ca.Function:
    arguments = [equations.y, equations.v, equations.t, equations.parameters]
    return ca.Function("a", arguments, [ca.densify(equations.accelerations)])


# Gauge and energy -----------------------------------------------------------------------------------------------------


def _log_weights(equations: Equations, trials: list[_Trial]) -> tuple[Array | None, list[ca.SX]]:
    """Logarithms of the weights at the declared values, and the weights as expressions; None where loops disagree."""
    size, inner = equations.y.numel(), [k for k, link in enumerate(equations.links) if _inner(link)]
    logs = []
    for trial in trials:
        ratios = trial.gains[:, 0] / trial.gains[:, 1]  # c_end / c_start
        if np.any(ratios[inner] <= 0) or not np.all(np.isfinite(ratios[inner])):
            return None, []
        found = _logs(equations, trial)
        for k in inner:
            i, j = _ends(equations.links[k])
            if abs(found[j] - found[i] - np.log(ratios[k])) > SAME * size:
                return None, []
        logs.append(found)
    firsts, expressions = _least_of_parts(equations, logs[0]), [ca.SX(1)] * size
    for k, forwards in _walk(equations, firsts):
        i, j = _ends(equations.links[k])
        first, second = equations.gains(equations.links[k])
        ratio = ca.SX(1) if ca.is_equal(first, second, 4) else first / second
        if forwards:
            expressions[j] = expressions[i] * ratio
        else:
            expressions[i] = expressions[j] / ratio
    (values,) = equations.at_nominal([ca.log(c) for c in expressions])
    return values, expressions


def _logs(equations: Equations, trial: _Trial) -> Array:
    """Logarithms of the weights along a tree of bonds, 0 where it begins."""
    logs = np.zeros(equations.y.numel())
    for k, forwards in _walk(equations, range(logs.size)):
        i, j = _ends(equations.links[k])
        rate = float(np.log(trial.gains[k, 0] / trial.gains[k, 1]))
        logs[j if forwards else i] = logs[i] + rate if forwards else logs[j] - rate
    return logs


def _inner(link: Link) -> bool:
    return link.start is not None and link.end is not None


def _ends(link: Link) -> tuple[int, int]:
    assert link.start is not None
    assert link.end is not None
    return link.start, link.end


def _walk(equations: Equations, firsts: Iterable[int]) -> Iterator[tuple[int, bool]]:
    """Bonds of a tree through each connected part, and whether they are gone along from start to end."""
    touching: dict[int, list[int]] = {}
    for k, link in enumerate(equations.links):
        if _inner(link):
            for i in _ends(link):
                touching.setdefault(i, []).append(k)
    seen: set[int] = set()
    for first in firsts:
        if first in seen:
            continue
        queue = deque([first])
        seen.add(first)
        while queue:
            here = queue.popleft()
            for k in touching.get(here, ()):
                i, j = _ends(equations.links[k])
                there = j if i == here else i
                if there not in seen:
                    seen.add(there)
                    queue.append(there)
                    yield k, i == here


def _least_of_parts(equations: Equations, logs: Array) -> list[int]:
    """Sites in the order of their weights, so that the first of each connected part has the least."""
    return [int(i) for i in np.argsort(logs, kind="stable")]


def _energy(equations: Equations, log_weights: Array | None, weights: list[ca.SX]) -> ca.SX | None:
    """The energy in the symbols of the model; None where it is not conserved, too large, or not known."""
    if log_weights is None or not equations.autonomous or np.max(log_weights, initial=0.0) > LARGEST:
        return None
    declaration, total = equations.declaration, ca.SX(0)
    y, v = ca.vertsplit(equations.y), ca.vertsplit(equations.v)
    kinds = {"onsite": "y", "force": "d"}
    potentials: dict[tuple[str, int, str], ca.Function] = {}
    for key, formula in declaration.formulas.items():
        if key[2] in kinds:
            potentials[key] = antiderivative(formula, kinds[key[2]])
            if potentials[key] is None:
                return None

    def potential(key: tuple[str, int, str], cell: tuple[int, ...], at: ca.SX) -> ca.SX:
        values, name = equations.values(cell), kinds[key[2]]
        others = [values[other] for other in declaration.formulas[key].names if other != name]
        return potentials[key](at, *others)

    for cell in declaration.all_cells():
        for s in range(len(declaration.sites)):
            i = declaration.index(cell, s)
            kinetic = equations.masses[i] * v[i] ** 2 / 2
            total += weights[i] * (kinetic + potential(("site", s, "onsite"), cell, y[i]))
    for link in equations.links:
        first, second = equations.gains(link)
        strength = ca.SX(0)
        if link.start is not None:
            strength = weights[link.start] * first
        elif link.end is not None:
            strength = weights[link.end] * second
        total += strength * potential(("bond", link.bond, "force"), link.cell, equations.extension(link))
    return total if _is_conserved(equations, total, log_weights) else None


# Checks at random points ----------------------------------------------------------------------------------------------


def _is_conserved(equations: Equations, energy: ca.SX, log_weights: Array) -> bool:
    """Whether the energy keeps its value, at random states of the gauge, to rounding of its own terms."""
    slope_y, slope_v = (ca.densify(ca.gradient(energy, x)) for x in (equations.y, equations.v))
    change = ca.vertcat(slope_y * equations.v, slope_v * equations.accelerations)
    rate = ca.Function("rate", [equations.y, equations.v, equations.parameters], [change])
    for trial in _trials(equations):
        scale = np.exp(-0.5 * log_weights)
        terms = np.array(rate(scale * trial.y, scale * trial.v, trial.parameters))
        if not abs(terms.sum()) <= SAME * terms.size * np.sum(np.abs(terms)):
            return False
    return True


def _is_gradient(equations: Equations, trials: list[_Trial]) -> bool:
    """Whether c_i mass_i times the derivative of the acceleration of i by y_j is that of j by y_i."""
    arguments = [equations.y, equations.parameters]
    derivative = ca.Function("J", arguments, [ca.jacobian(equations.accelerations, equations.y)])
    for trial in trials:
        logs = _logs(equations, trial)
        J = derivative(trial.y, trial.parameters).sparse()
        half = 0.5 * (logs + np.log(trial.masses))
        i, j = J.nonzero()
        entries = np.asarray(J[i, j]).ravel() * np.exp(half[i] - half[j])
        opposite = np.asarray(J[j, i]).ravel() * np.exp(half[j] - half[i])
        if not np.all(np.abs(entries - opposite) <= SAME * half.size * np.max(np.abs(entries), initial=0.0)):
            return False
    return True


def _is_odd(equations: Equations, trials: list[_Trial]) -> bool:
    field = _field(equations)
    for trial in trials:
        there = np.array(field(trial.y, trial.v, trial.t, trial.parameters))
        back = np.array(field(-trial.y, -trial.v, trial.t, trial.parameters))
        if equations.driven:  # the forces beside the drive
            rest = np.array(field(0 * trial.y, 0 * trial.v, trial.t, trial.parameters))
            there, back = there - rest, back - rest
        if not np.max(np.abs(there + back)) <= SAME * np.max(np.abs(there)):
            return False
    return True


def _keeps_momentum(equations: Equations, trials: list[_Trial]) -> bool:
    """Whether the weighted forces add up to zero; in a lattice without gauge envelope."""
    field = _field(equations)
    for trial in trials:
        if np.any(trial.gains[:, 0] != trial.gains[:, 1]):
            return False
        forces = trial.masses * np.array(field(trial.y, trial.v, trial.t, trial.parameters)).ravel()
        if not abs(forces.sum()) <= SAME * np.sum(np.abs(forces)):
            return False
    return True


def _mirrors(equations: Equations, trials: list[_Trial]) -> tuple[int, ...]:
    """Directions along which the mirrored lattice, with the sites of a cell in reversed order, is the same."""
    declaration, field = equations.declaration, _field(equations)
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


def _is_polynomial(equations: Equations) -> bool:
    at = ca.vertcat(equations.parameters, equations.t)
    accelerations = ca.substitute(equations.accelerations, at, ca.vertcat(ca.DM(equations.nominal), 0.0))
    try:
        homogeneous_parts(accelerations, ca.vertcat(equations.y, equations.v))
    except (NotPolynomialError, ValueError):
        return False
    return True
