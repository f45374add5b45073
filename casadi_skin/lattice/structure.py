"""Structure of a lattice: gauge, energy, momentum, oddness, mirrors; each is checked at random points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import CELL_INDICES, Array, Declaration
from casadi_skin.lattice.equations import Equations
from casadi_skin.model.expressions import antiderivative
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts
from casadi_skin.zero.linear_modes import tree_of
from casadi_skin.zero.problem import Indices

# Random points at which the properties of a lattice are checked -------------------------------------------------------

SAME_VALUE_RTOL = 1e-12  # relative difference of values that are the same but for rounding, per site
RANDOM_POINTS = 3  # random points
RANDOM_AMPLITUDES = (1.0, 0.1, 0.01)  # of random positions: the first at which all forces are finite
# Relative change of parameters at random points: a property of the declared values alone is not declared.
PARAMETER_SPREAD = 0.1


@dataclass(frozen=True)
class Trial:
    """Random parameters, their gains and masses, and a random state with unit sizes."""

    parameters: Array
    gains: Array
    masses: Array
    y: Array
    v: Array
    t: float
    field: ca.Function

    def accelerations(self, y: Array, v: Array) -> Array:
        """Accelerations in another state at the same time and parameters, shape (sites,)."""
        return np.array(self.field(y, v, self.t, self.parameters)).ravel()


def trials_of(equations: Equations) -> Iterator[Trial]:
    """The declared parameters, then others near them."""
    generator, nominal = np.random.default_rng(0), np.array(equations.nominal)
    spread = np.array([PARAMETER_SPREAD if name.isidentifier() else 0.0 for name in equations.symbols])  # numbers stay
    gains = [gain for pair in equations.gains for gain in pair]
    evaluate = ca.Function("f", [equations.parameters], [ca.vertcat(ca.SX(0, 1), *gains), equations.masses])
    arguments = [equations.y, equations.v, equations.t, equations.parameters]
    field = ca.Function("a", arguments, [ca.densify(equations.accelerations)])
    for k in range(RANDOM_POINTS):
        parameters = nominal * (1.0 + (spread * generator.uniform(-1, 1, nominal.size) if k else 0.0))
        found = [np.array(value).ravel() for value in evaluate(parameters)]
        y, v = (generator.normal(size=equations.y.numel()) for _ in "yv")
        t = generator.normal()
        for amplitude in RANDOM_AMPLITUDES:
            trial = Trial(parameters, found[0].reshape(-1, 2), found[1], amplitude * y, v, t, field)
            if np.all(np.isfinite(trial.accelerations(trial.y, v))):
                break
        yield trial


def _is_zero(array: Array, beside: Array, count: int = 1) -> bool:
    """Whether the largest entry is rounding beside that of another array; false where one is not finite."""
    return bool(np.max(np.abs(array), initial=0.0) <= SAME_VALUE_RTOL * count * np.max(np.abs(beside), initial=0.0))


# The gauge of a lattice: weights with which the forces are a gradient, and the energy that these give -----------------

DEEPEST_GAIN = 50  # operations on operations in gains that are compared
# Logarithm of a weight of the energy that is still a double when squared displacements multiply it.
LARGEST_LOG_WEIGHT = 600.0


def log_weights_of(equations: Equations, trials: list[Trial]) -> tuple[Array | None, list[ca.SX]]:
    """Logarithms of the weights at the declared values, and the weights as expressions; None where loops disagree."""
    size, inner, logs = equations.y.numel(), equations.inner, list[Array]()
    for trial in trials:
        ratios = (trial.gains[:, 0] / trial.gains[:, 1])[inner]  # c_end / c_start
        if np.any(ratios <= 0) or not np.all(np.isfinite(ratios)):
            return None, []
        logs.append(logs_of(equations, trial.gains))
        change = np.diff(logs[-1][np.reshape(equations.ends, (-1, 2)).astype(int)])[:, 0]
        if np.any(np.abs(change - np.log(ratios)) > SAME_VALUE_RTOL * size):
            return None, []
    firsts, expressions = np.argsort(logs[0], kind="stable"), [ca.SX(1)] * size  # of each part the first has the least
    for k, here, there, forwards in tree_of(size, equations.ends, firsts.tolist()):
        first, second = equations.gains[inner[k]]
        alike = ca.is_equal(first, second, DEEPEST_GAIN)
        ratio = 1 if alike else first / second if forwards else second / first
        expressions[there] = expressions[here] * ratio
    (values,) = equations.at_nominal(ca.log(ca.vertcat(*expressions)))
    return values, expressions


def logs_of(equations: Equations, gains: Array) -> Array:
    """Logarithms of the weights along a tree of bonds, 0 where it begins, from the gains of all, shape (links, 2)."""
    logs, rates = np.zeros(equations.y.numel()), np.log(gains[equations.inner, 0] / gains[equations.inner, 1])
    for k, here, there, forwards in equations.tree:
        logs[there] = logs[here] + rates[k] if forwards else logs[here] - rates[k]
    return logs


def is_gradient(equations: Equations, trials: list[Trial]) -> bool:
    """Whether c_i mass_i times the derivative of the acceleration of i by y_j is that of j by y_i."""
    arguments = [equations.y, equations.parameters]
    derivative = ca.Function("J", arguments, [ca.jacobian(equations.accelerations, equations.y)])
    for trial in trials:
        half = 0.5 * (logs_of(equations, trial.gains) + np.log(trial.masses))
        J = derivative(trial.y, trial.parameters).sparse()
        i, j = J.nonzero()
        entries, opposite = (np.asarray(J[at]).ravel() * np.exp(half[at[0]] - half[at[1]]) for at in ((i, j), (j, i)))
        if not _is_zero(entries - opposite, entries, half.size):
            return False
    return True


def site_energies(equations: Equations, log_weights: Array | None, weights: list[ca.SX]) -> ca.SX | None:
    """Kinetic and onsite energy of every site and half of that of its bonds, a column; None for unknown potentials.

    A bond to a wall belongs to its one site. Weights are those of the gauge; without one, or where doubles do not hold
    them, they are 1, and a bond has the mean of its gains.
    """
    in_gauge = log_weights is not None and np.max(log_weights, initial=0.0) <= LARGEST_LOG_WEIGHT
    declaration, kinds = equations.declaration, {"onsite": "y", "force": "d"}
    potentials: dict[tuple[str, int, str], ca.Function] = {}
    for key, formula in declaration.formulas.items():
        if key[2] in kinds:
            potentials[key] = antiderivative(formula, kinds[key[2]])
            if potentials[key] is None:
                return None

    def potential(key: tuple[str, int, str], cells: list[tuple[int, ...]], at: ca.SX) -> ca.SX:
        values, name = equations.values(cells), kinds[key[2]]
        others = [values[other] for other in declaration.formulas[key].names if other != name]
        rows = [at.T, *(ca.repmat(other, 1, len(cells)) if other.numel() == 1 else other.T for other in others)]
        return potentials[key](*rows).T

    sites = len(declaration.sites)
    c = ca.vertcat(*weights) if in_gauge else ca.SX.ones(declaration.size)
    energies = c * equations.masses * equations.v**2 / 2
    for s in range(sites):
        energies[s::sites] += c[s::sites] * potential(("site", s, "onsite"), equations.cells, equations.y[s::sites])
    for b in range(len(declaration.bonds)):
        links = equations.links_of(b)
        gains = [equations.gains[k] for k, link in enumerate(equations.links) if link.bond == b]
        energy = potential(("bond", b, "force"), [link.cell for link in links], equations.extensions(links))
        for chosen, ends, share in (
            ([k for k, link in enumerate(links) if link.end is None], (0,), 1.0),
            ([k for k, link in enumerate(links) if link.start is None], (1,), 1.0),
            ([k for k, link in enumerate(links) if link.inner], (0, 1), 0.5),
        ):
            at = [[(links[k].start, links[k].end)[side] for k in chosen] for side in ends]
            strengths = [c[at[n]] * ca.vertcat(*(gains[k][side] for k in chosen)) for n, side in enumerate(ends)]
            strength = strengths[0] if in_gauge or len(ends) == 1 else (strengths[0] + strengths[1]) / 2
            for place in at if chosen else []:
                energies[place] += share * strength * energy[chosen]
    return energies


def is_conserved(equations: Equations, energy: ca.SX, log_weights: Array, trials: list[Trial]) -> bool:
    """Whether the energy keeps its value, at random states of the gauge, to rounding of its own terms."""
    slope = ca.densify(ca.gradient(energy, ca.vertcat(equations.y, equations.v)))
    change = slope * ca.vertcat(equations.v, equations.accelerations)
    rate = ca.Function("rate", [equations.y, equations.v, equations.parameters], [change])
    for trial in trials:
        scale = np.exp(-0.5 * log_weights)
        terms = np.array(rate(scale * trial.y, scale * trial.v, trial.parameters))
        if not abs(terms.sum()) <= SAME_VALUE_RTOL * terms.size * np.sum(np.abs(terms)):
            return False
    return True


def is_odd(trial: Trial, driven: bool) -> bool:
    """Whether the forces beside the drive change their sign with the state."""
    rest = trial.accelerations(0.0 * trial.y, 0.0 * trial.v) if driven else 0.0
    there, back = (trial.accelerations(sign * trial.y, sign * trial.v) - rest for sign in (1.0, -1.0))
    return _is_zero(there + back, there)


def keeps_momentum(trial: Trial) -> bool:
    """Whether the weighted forces add up to zero; in a lattice without gauge envelope."""
    forces = trial.masses * trial.accelerations(trial.y, trial.v)
    alike = np.array_equal(trial.gains[:, 0], trial.gains[:, 1])
    return alike and bool(abs(forces.sum()) <= SAME_VALUE_RTOL * np.sum(np.abs(forces)))


def is_mirrored(trial: Trial, order: Indices) -> bool:
    """Whether the lattice is the same with its sites in another order."""
    there, image = trial.accelerations(trial.y, trial.v), trial.accelerations(trial.y[order], trial.v[order])
    return _is_zero(image - there[order], there)


def mirrors_of(declaration: Declaration, trials: list[Trial]) -> tuple[int, ...]:
    """Directions along which the mirrored lattice, with the sites of a cell in reversed order, is the same."""
    numbers = np.arange(declaration.size).reshape(*declaration.cells, len(declaration.sites))
    orders = [np.flip(np.flip(numbers, axis=k), axis=-1).ravel() for k in range(len(declaration.cells))]
    return tuple(k for k, order in enumerate(orders, start=1) if all(is_mirrored(trial, order) for trial in trials))


def is_polynomial(equations: Equations) -> bool:
    """Whether all forces are polynomials of positions and velocities, formula by formula."""
    declaration = equations.declaration
    for (kind, number, field), formula in declaration.formulas.items():
        varying = {*CELL_INDICES, *declaration.by_cell} & set(formula.names)
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
        if np.max(log_weights) <= LARGEST_LOG_WEIGHT and is_conserved(equations, total, log_weights, trials):
            energy = total
    return Structure(
        log_weights, energy, energies, all(is_odd(trial, equations.driven) for trial in trials),
        is_polynomial(equations), log_weights is not None and equations.autonomous and all(map(keeps_momentum, trials)),
        mirrors_of(equations.declaration, trials), equations.damped, equations.driven,
    )  # fmt: skip
