"""The gauge of a lattice: weights with which the forces are a gradient, and the energy that these give."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import Array, Link
from casadi_skin.lattice.equations import Equations
from casadi_skin.lattice.trials import SAME, Trial
from casadi_skin.model.expressions import antiderivative

DEEPEST = 50  # operations on operations in gains that are compared
LARGEST = 600.0  # logarithm of a weight of the energy that is still a double when squared displacements multiply it


def log_weights_of(equations: Equations, trials: list[Trial]) -> tuple[Array | None, list[ca.SX]]:
    """Logarithms of the weights at the declared values, and the weights as expressions; None where loops disagree."""
    size, inner = equations.y.numel(), equations.inner
    start, end = (np.array([_ends(equations.links[k])[side] for k in inner], dtype=int) for side in (0, 1))
    logs = []
    for trial in trials:
        ratios = (trial.gains[:, 0] / trial.gains[:, 1])[inner]  # c_end / c_start
        if np.any(ratios <= 0) or not np.all(np.isfinite(ratios)):
            return None, []
        found = logs_of(equations, trial.gains)
        if np.any(np.abs(found[end] - found[start] - np.log(ratios)) > SAME * size):
            return None, []
        logs.append(found)
    firsts, expressions = np.argsort(logs[0], kind="stable"), [ca.SX(1)] * size  # of each part the first has the least
    alike = [ca.is_equal(*pair, DEEPEST) for pair in equations.gains]
    for k, forwards in _walk(equations, firsts.tolist()):
        i, j = _ends(equations.links[k])
        first, second = equations.gains[k]
        here, there = (i, j) if forwards else (j, i)
        ratio = 1 if alike[k] else first / second if forwards else second / first
        expressions[there] = expressions[here] * ratio
    (values,) = equations.at_nominal(ca.log(ca.vertcat(*expressions)))
    return values, expressions


def logs_of(equations: Equations, gains: Array) -> Array:
    """Logarithms of the weights along a tree of bonds, 0 where it begins, from the gains of all, shape (links, 2)."""
    logs, rates = [0.0] * equations.y.numel(), np.zeros(len(equations.links))
    inner = equations.inner
    rates[inner] = np.log(gains[inner, 0] / gains[inner, 1])
    for k, forwards in _tree(equations):
        i, j = _ends(equations.links[k])
        if forwards:
            logs[j] = logs[i] + rates[k]
        else:
            logs[i] = logs[j] - rates[k]
    return np.array(logs)


def _ends(link: Link) -> tuple[int, int]:
    assert link.start is not None
    assert link.end is not None
    return link.start, link.end


@lru_cache(maxsize=2)
def _tree(equations: Equations) -> list[tuple[int, bool]]:
    """The bonds of a tree from the first site of each connected part."""
    return list(_walk(equations, range(equations.y.numel())))


def _walk(equations: Equations, firsts: Iterable[int]) -> Iterator[tuple[int, bool]]:
    """Bonds of a tree through each connected part, and whether they are gone along from start to end."""
    touching: dict[int, list[tuple[int, int, bool]]] = {}
    for k in equations.inner:
        i, j = _ends(equations.links[k])
        touching.setdefault(i, []).append((k, j, True))
        touching.setdefault(j, []).append((k, i, False))
    seen: set[int] = set()
    for first in firsts:
        if first in seen:
            continue
        queue = deque([first])
        seen.add(first)
        while queue:
            for k, there, forwards in touching.get(queue.popleft(), ()):
                if there not in seen:
                    seen.add(there)
                    queue.append(there)
                    yield k, forwards


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
        if not abs(terms.sum()) <= SAME * terms.size * np.sum(np.abs(terms)):
            return False
    return True
