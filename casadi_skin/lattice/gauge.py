"""The gauge of a lattice: weights with which the forces are a gradient, and the energy that these give."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import Array, Link
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.expressions import antiderivative
from casadi_skin.lattice.trials import SAME, Trial, trials_of

LARGEST = 600.0  # logarithm of a weight of the energy that is still a double when squared displacements multiply it


def log_weights_of(equations: Equations, trials: list[Trial]) -> tuple[Array | None, list[ca.SX]]:
    """Logarithms of the weights at the declared values, and the weights as expressions; None where loops disagree."""
    size, inner = equations.y.numel(), [k for k, link in enumerate(equations.links) if _inner(link)]
    logs = []
    for trial in trials:
        ratios = trial.gains[:, 0] / trial.gains[:, 1]  # c_end / c_start
        if np.any(ratios[inner] <= 0) or not np.all(np.isfinite(ratios[inner])):
            return None, []
        found = logs_of(equations, trial.gains)
        for k in inner:
            i, j = _ends(equations.links[k])
            if abs(found[j] - found[i] - np.log(ratios[k])) > SAME * size:
                return None, []
        logs.append(found)
    firsts, expressions = _least_of_parts(equations, logs[0]), [ca.SX(1)] * size
    for k, forwards in _walk(equations, firsts):
        i, j = _ends(equations.links[k])
        first, second = equations.gains[k]
        ratio = ca.SX(1) if ca.is_equal(first, second, 4) else first / second
        if forwards:
            expressions[j] = expressions[i] * ratio
        else:
            expressions[i] = expressions[j] / ratio
    (values,) = equations.at_nominal(ca.log(ca.vertcat(*expressions)))
    return values, expressions


def logs_of(equations: Equations, gains: Array) -> Array:
    """Logarithms of the weights along a tree of bonds, 0 where it begins, from the gains of all, shape (links, 2)."""
    logs = np.zeros(equations.y.numel())
    for k, forwards in _walk(equations, range(logs.size)):
        i, j = _ends(equations.links[k])
        rate = float(np.log(gains[k, 0] / gains[k, 1]))
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


def is_gradient(equations: Equations, trials: list[Trial]) -> bool:
    """Whether c_i mass_i times the derivative of the acceleration of i by y_j is that of j by y_i."""
    arguments = [equations.y, equations.parameters]
    derivative = ca.Function("J", arguments, [ca.jacobian(equations.accelerations, equations.y)])
    for trial in trials:
        logs = logs_of(equations, trial.gains)
        J = derivative(trial.y, trial.parameters).sparse()
        half = 0.5 * (logs + np.log(trial.masses))
        i, j = J.nonzero()
        entries = np.asarray(J[i, j]).ravel() * np.exp(half[i] - half[j])
        opposite = np.asarray(J[j, i]).ravel() * np.exp(half[j] - half[i])
        if not np.all(np.abs(entries - opposite) <= SAME * half.size * np.max(np.abs(entries), initial=0.0)):
            return False
    return True


def site_energies(equations: Equations, log_weights: Array | None, weights: list[ca.SX]) -> ca.SX | None:
    """Kinetic and onsite energy of every site and half of that of its bonds, a column; None for unknown potentials.

    A bond to a wall belongs to its one site. Weights are those of the gauge; without one, or where doubles do not hold
    them, they are 1, and a bond has the mean of its gains.
    """
    in_gauge = log_weights is not None and np.max(log_weights, initial=0.0) <= LARGEST
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
            ([k for k, link in enumerate(links) if _inner(link)], (0, 1), 0.5),
        ):
            at = [[(links[k].start, links[k].end)[side] for k in chosen] for side in ends]
            strengths = [c[at[n]] * ca.vertcat(*(gains[k][side] for k in chosen)) for n, side in enumerate(ends)]
            strength = strengths[0] if in_gauge or len(ends) == 1 else (strengths[0] + strengths[1]) / 2
            for place in at if chosen else []:
                energies[place] += share * strength * energy[chosen]
    return energies


def is_conserved(equations: Equations, energy: ca.SX, log_weights: Array) -> bool:
    """Whether the energy keeps its value, at random states of the gauge, to rounding of its own terms."""
    slope_y, slope_v = (ca.densify(ca.gradient(energy, x)) for x in (equations.y, equations.v))
    change = ca.vertcat(slope_y * equations.v, slope_v * equations.accelerations)
    rate = ca.Function("rate", [equations.y, equations.v, equations.parameters], [change])
    for trial in trials_of(equations):
        scale = np.exp(-0.5 * log_weights)
        terms = np.array(rate(scale * trial.y, scale * trial.v, trial.parameters))
        if not abs(terms.sum()) <= SAME * terms.size * np.sum(np.abs(terms)):
            return False
    return True
