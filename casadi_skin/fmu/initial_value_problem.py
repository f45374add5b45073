"""The initial-value problem of an FMU: a model and its start, from a chain, a model, or an orbit of either."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.arguments import number, numbers, short_repr
from casadi_skin.model.ode import OdeModel

LONGEST_NAME = 60  # characters of an identifier: names of files are made of it
PERIODS = 10  # of the linear mode, the orbit or the forcing, in the default experiment
SAMPLES = 256  # of an orbit, for the sizes along it
SMALLEST = 1e-250  # size of a state that is distinguished from zero
DEFAULT_S = 0.01  # amplitude of a start from a linear mode: small, so that the mode is nearly an orbit

Bounds = tuple[float, float]


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """A model x' = f(t, x, p) with outputs y(t, x, p) and its start; dimensionless.

    `start` and `nominals` (usual sizes) have one value a state, `parameters` one a parameter; the last parameters are
    the `inputs`. `bounds` limit parameters and `meanings` describe variables, both by name. `chain` is true where
    states are displacements, then velocities, of a chain.
    """

    model: OdeModel
    description: str
    start: tuple[float, ...]
    parameters: tuple[float, ...]
    nominals: tuple[float, ...]
    stop_time: float
    tolerance: float
    inputs: tuple[str, ...] = ()
    chain: bool = False
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    meanings: Mapping[str, str] = field(default_factory=dict)

    @property
    def identifier(self) -> str:
        """The model's name as an identifier of C: letters, digits and single underscores, others by their numbers."""
        plain = "".join(c if c.isascii() or not c.isalnum() else f"_u{ord(c):x}_" for c in self.model.name)
        name = re.sub(r"[\W_]+", "_", plain, flags=re.ASCII).strip("_")[:LONGEST_NAME].strip("_") or "model"
        return name if name[0].isalpha() else f"model_{name}"


def initial_value_problem(
    what: object,
    start: ArrayLike | None,
    mode: int | str | None,
    S: float | None,
    stop_time: float | None,
    tolerance: float,
) -> InitialValueProblem:
    """The initial-value problem of `export_fmu`; raises TypeError and ValueError as that does."""
    if stop_time is not None and number("stop_time", stop_time, "a finite number > 0") <= 0:
        raise ValueError(f"stop_time: given {stop_time!r}; accepted: a finite number > 0")
    if not 1e-14 <= number("tolerance", tolerance) <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-14 to 1e-2")
    if not isinstance(what, Chain):
        for name, given in (("mode", mode), ("S", S)):
            if given is not None:
                raise ValueError(
                    f"{name}: given {short_repr(given)}; accepted: with a Chain, which starts from a linear mode"
                )
    if isinstance(what, OdeModel):
        return _of_model(what, start, what.nominal, stop_time, tolerance)
    if isinstance(what, Orbit):
        start, stop = what.profile if start is None else start, stop_time or PERIODS * what.period
        sizes = sizes_along(what)
        if isinstance(what.model, Chain):
            return _of_chain(what.model, start, sizes, stop, tolerance)
        return _of_model(what.model, start, tuple(what.model_parameters.tolist()), stop, tolerance, sizes)
    if not isinstance(what, Chain):
        raise TypeError(f"what: given {short_repr(what)}; accepted: a Chain, an OdeModel or an orbit")
    if what.infinite:
        raise ValueError("sites: given inf; accepted: a finite chain")
    mode, S = 1 if mode is None else mode, DEFAULT_S if S is None else S
    frequency = what.linear_frequency(mode)
    start = _linear_mode(what, mode, S) if start is None else start
    stop = PERIODS * 2.0 * np.pi / frequency if stop_time is None else stop_time
    return _of_chain(what, start, _sizes_in_gauge(what, start, frequency), stop, tolerance)


# Sizes --------------------------------------------------------------------------------------------------------------


def sizes_along(orbit: Orbit) -> Array:
    """The largest value of every component of the first-order state along an orbit."""
    t = orbit.period * np.arange(SAMPLES) / SAMPLES
    if isinstance(orbit.model, Chain):
        sizes = np.abs(np.asarray(orbit.profile))  # at rest all displacements are largest
        return np.concatenate([sizes, orbit.Omega * sizes])
    states = np.abs(orbit.evaluate(t))
    if states.shape[1] < orbit.model.full_size:
        states = np.hstack([states, np.abs(np.gradient(orbit.evaluate(t), t, axis=0))])
    return np.asarray(states.max(axis=0))


def _sizes_in_gauge(chain: Chain, start: ArrayLike, frequency: float) -> Array:
    """Sizes of a motion from a start: as large in the gauge at all sites, and nowhere larger than at the start."""
    y = np.abs(np.resize(np.asarray(numbers("start", start)), chain.sites))
    largest = float(y.max()) or 1.0
    if abs(chain.gamma) < 1:
        with np.errstate(over="ignore"):
            y = np.minimum(chain.rho * np.max(y / chain.rho), largest) if y.any() else chain.rho / np.max(chain.rho)
    return np.concatenate([y, frequency * y])


def _nominals(sizes: ArrayLike) -> tuple[float, ...]:
    """Usual sizes, none of them zero: those that vanish are as the smallest other one."""
    found = np.asarray(sizes, dtype=float)
    some = found[np.isfinite(found) & (found >= SMALLEST)]
    return tuple(np.where(found >= SMALLEST, found, some.min() if some.size else 1.0).tolist())


# Chains -------------------------------------------------------------------------------------------------------------


def chain_with_outputs(chain: Chain) -> OdeModel:
    """The chain in physical coordinates y, then v, with parameters alpha, gamma, g and outputs energy and S.

    Written in whole vectors: the C that CasADi generates of it has loops, and hardly grows with the number of sites.
    At |gamma| = 1 the energy is infinite, and left out.
    """
    sites = chain.sites
    x, p = ca.MX.sym("x", 2 * sites), ca.MX.sym("p", 3)
    y, v = x[:sites], x[sites:]
    alpha, gamma, g = ca.vertsplit(p)
    edge = ca.MX.zeros(1)
    below, above = (edge, edge) if sites == 1 else (ca.vertcat(edge, y[:-1]), ca.vertcat(y[1:], edge))
    force = (1 + gamma) * below + (1 - gamma) * above - (2 + alpha) * y - g * y**3
    names = [f"{letter}_{n}" for letter in "yv" for n in range(1, sites + 1)]
    conserved = {} if abs(chain.gamma) == 1 else {"energy": _energy(y, v, alpha, gamma, g)}
    return OdeModel(
        name="chain",
        state=x,
        rhs=ca.vertcat(v, force),
        parameters=p,
        outputs=conserved | {"S": ca.sumsqr(y)},
        nominal=(chain.alpha, chain.gamma, chain.g),
        state_labels=tuple(names),
        parameter_labels=("alpha", "gamma", "g"),
        checked=False,
    )


def _energy(y: ca.MX, v: ca.MX, alpha: ca.MX, gamma: ca.MX, g: ca.MX) -> ca.MX:
    """Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to, in y and v, for any |gamma| < 1.

    With s = (1 + gamma)/(1 - gamma), 1/rho_n^2 is s^(N-n) for gamma >= 0 and s^(1-n) below, always the larger one, and
    so is the coupling: no root is left to be differentiated, and nothing jumps where gamma changes its sign.
    """
    sites = y.numel()
    number, ratio = ca.DM(np.arange(1.0, sites + 1.0)), (1 + gamma) / (1 - gamma)
    weight = ca.fmax(ratio ** (sites - number), ratio ** (1 - number))
    energy = ca.dot(weight, v**2 + (2 + alpha) * y**2 + g * y**4 / 2) / 2
    if sites == 1:
        return energy
    first = number[:-1]
    coupling = ca.fmax((1 + gamma) * ratio ** (sites - 1 - first), (1 - gamma) * ratio ** (1 - first))
    return energy - ca.dot(coupling, y[:-1] * y[1:])


def _linear_mode(chain: Chain, mode: int | str, S: float) -> Array:
    """Displacements of a linear mode with sum of y_n^2 = S, the largest positive."""
    if number("S", S, "a finite number >= 0") < 0:
        raise ValueError(f"S: given {S!r}; accepted: a finite number >= 0")
    vector = chain.right_eigenvector(chain.mode_number(mode))
    return np.asarray(vector * np.sign(vector[np.argmax(np.abs(vector))]) * np.sqrt(S) / np.linalg.norm(vector))


def _of_chain(
    chain: Chain, start: ArrayLike, sizes: ArrayLike, stop_time: float, tolerance: float
) -> InitialValueProblem:
    sites = chain.sites
    given = _start(start, sites, 2 * sites)
    full = given + (0.0,) * (2 * sites - len(given))
    numbered = range(1, sites + 1)
    meanings = {f"y_{n}": f"displacement of site {n}" for n in numbered}
    meanings |= {f"v_{n}": f"velocity of site {n}" for n in numbered}
    meanings |= {
        "alpha": "stiffness of the ground springs",
        "gamma": "nonreciprocity: couplings 1 + gamma to the left neighbour, 1 - gamma to the right one",
        "g": "coefficient of the cubic force",
        "energy": "Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to",
        "S": "sum of the squared displacements",
    }
    return InitialValueProblem(
        model=chain_with_outputs(chain),
        description=f"Nonreciprocal Klein-Gordon chain of {sites} sites, fixed ends (arXiv:2512.17483, Eq. 1)",
        start=full,
        parameters=(chain.alpha, chain.gamma, chain.g),
        nominals=_nominals(sizes),
        stop_time=stop_time,
        tolerance=tolerance,
        chain=True,
        bounds={"gamma": (-1.0, 1.0)},
        meanings=meanings,
    )


# Models ---------------------------------------------------------------------------------------------------------------


def _of_model(
    model: OdeModel,
    start: ArrayLike | None,
    values: tuple[float, ...] | None,
    stop_time: float | None,
    tolerance: float,
    sizes: ArrayLike | None = None,
) -> InitialValueProblem:
    count = model.full_size
    if model.parameter_names and values is None:
        raise ValueError(f"{model.name}: no nominal values of {', '.join(model.parameter_names)}; accepted: one each")
    parameters = tuple(float(value) for value in values or ())
    given = (0.0,) * count if start is None else _start(start, *{model.size, count})
    names = [*model.state_names, *(f"der({name})" for name in model.state_names)]
    names += [*model.parameter_names, *model.outputs, "time"]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(
            f"{model.name}: several variables named {', '.join(twice)}; accepted: a name each ('time' is t)"
        )
    full = given + (0.0,) * (count - len(given))
    largest = max(map(abs, full)) or 1.0
    return InitialValueProblem(
        model=model,
        description=model.name,
        start=full,
        parameters=parameters,
        nominals=_nominals([largest] * count if sizes is None else sizes),
        stop_time=_default_stop(model, parameters) if stop_time is None else stop_time,
        tolerance=tolerance,
    )


def _default_stop(model: OdeModel, parameters: Iterable[float]) -> float:
    return PERIODS * abs(model.forcing_period_at(list(parameters))) if model.forced else float(PERIODS)


def _start(given: ArrayLike, *counts: int) -> tuple[float, ...]:
    values = numbers("start", given)
    if len(values) not in counts:
        raise ValueError(f"start: given {len(values)} values; accepted: {' or '.join(map(str, sorted(counts)))}")
    return values
