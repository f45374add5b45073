"""The initial-value problem of an FMU: a model and its start, from a chain, a model, or an orbit of either."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin.export.codegen import c_source, plain_name, prototype, with_words
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.model.arguments import number, number_within, numbers, short_repr
from casadi_skin.model.jumps import INPUT, OPERATION_NAMES, STATE, TIME, Switch, switches
from casadi_skin.model.ode import OdeModel

SOURCES = resources.files("casadi_skin.fmu") / "sources"
LONGEST_NAME = 60  # characters of an identifier: names of files are made of it
DEFAULT_PERIODS = 10  # of the linear mode, the orbit or the forcing, in the default experiment
ORBIT_SAMPLES = 256  # of an orbit, for the sizes along it
SMALLEST_STATE_SIZE = 1e-250  # size of a state that is distinguished from zero
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
        name = plain_name(self.model.name)[:LONGEST_NAME].strip("_") or "model"
        return name if name[0].isalpha() else f"model_{name}"


def initial_value_problem(
    source: object, start: ArrayLike | None, mode: int | str | None, S: float | None, stop_time: float | None,
    tolerance: float,
) -> InitialValueProblem:  # fmt: skip
    """The initial-value problem of `export_fmu`; raises TypeError and ValueError as that does."""
    if stop_time is not None and number("stop_time", stop_time, "a finite number > 0") <= 0:
        raise ValueError(f"stop_time: given {stop_time!r}; accepted: a finite number > 0")
    number_within("tolerance", tolerance, 1e-14, 1e-2)
    if not isinstance(source, Chain):
        for name, given in (("mode", mode), ("S", S)):
            if given is not None:
                accepted = "accepted: with a Chain, which starts from a linear mode"
                raise ValueError(f"{name}: given {short_repr(given)}; {accepted}")
    if isinstance(source, OdeModel):
        return _of_model(source, start, source.nominal, stop_time, tolerance)
    if isinstance(source, Orbit):
        start, stop = source.profile if start is None else start, stop_time or DEFAULT_PERIODS * source.period
        sizes = sizes_along(source)
        if isinstance(source.model, Chain):
            return _of_chain(source.model, start, sizes, stop, tolerance)
        return _of_model(source.model, start, tuple(source.model_parameters.tolist()), stop, tolerance, sizes)
    if not isinstance(source, Chain):
        raise TypeError(f"source: given {short_repr(source)}; accepted: a Chain, an OdeModel or an orbit")
    if source.infinite:
        raise ValueError("sites: given inf; accepted: a finite chain")
    mode, S = 1 if mode is None else mode, DEFAULT_S if S is None else S
    frequency = source.linear_frequency(mode)
    start = _linear_mode(source, mode, S) if start is None else start
    stop = DEFAULT_PERIODS * 2.0 * np.pi / frequency if stop_time is None else stop_time
    return _of_chain(source, start, _sizes_in_gauge(source, start, frequency), stop, tolerance)


# Sizes --------------------------------------------------------------------------------------------------------------


def sizes_along(orbit: Orbit) -> Array:
    """The largest value of every component of the first-order state along an orbit."""
    t = orbit.period * np.arange(ORBIT_SAMPLES) / ORBIT_SAMPLES
    states = np.abs(orbit.evaluate(t))
    if states.shape[1] < orbit.model.tunable_model().full_size:
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
    some = found[np.isfinite(found) & (found >= SMALLEST_STATE_SIZE)]
    return tuple(np.where(found >= SMALLEST_STATE_SIZE, found, some.min() if some.size else 1.0).tolist())


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
        "chain", x, ca.vertcat(v, force), p, outputs=conserved | {"S": ca.sumsqr(y)},
        nominal=(chain.alpha, chain.gamma, chain.g), state_labels=tuple(names),
        parameter_labels=("alpha", "gamma", "g"), checked=False,
    )  # fmt: skip


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
    return np.asarray(np.sqrt(S) * chain.linear_spectrum().mode(chain.mode_number(mode)))


def _of_chain(chain: Chain, start: ArrayLike, sizes: ArrayLike, stop: float, tolerance: float) -> InitialValueProblem:
    sites = chain.sites
    given, numbered = _start(start, sites, 2 * sites), range(1, sites + 1)
    meanings = {f"y_{n}": f"displacement of site {n}" for n in numbered}
    meanings |= {f"v_{n}": f"velocity of site {n}" for n in numbered}
    meanings |= {
        "alpha": "stiffness of the ground springs",
        "gamma": "nonreciprocity: couplings 1 + gamma to the left neighbour, 1 - gamma to the right one",
        "g": "coefficient of the cubic force",
        "energy": "Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to",
        "S": "sum of the squared displacements",
    }
    full, values = (*given, *(0.0,) * sites)[: 2 * sites], tuple(chain.parameters.values())
    problem = _of_model(chain_with_outputs(chain), full, values, stop, tolerance, sizes)
    words = f"Nonreciprocal Klein-Gordon chain of {sites} sites, fixed ends (arXiv:2512.17483, Eq. 1)"
    return replace(problem, description=words, chain=True, bounds={"gamma": (-1.0, 1.0)}, meanings=meanings)


# Models ---------------------------------------------------------------------------------------------------------------


def _of_model(
    model: OdeModel, start: ArrayLike | None, values: tuple[float, ...] | None, stop_time: float | None,
    tolerance: float, sizes: ArrayLike | None = None,
) -> InitialValueProblem:  # fmt: skip
    count = model.full_size
    if model.parameter_names and values is None:
        raise ValueError(f"{model.name}: no nominal values of {', '.join(model.parameter_names)}; accepted: one each")
    parameters = tuple(float(value) for value in values or ())
    given = (0.0,) * count if start is None else _start(start, *{model.size, count})
    names = [*model.state_names, *(f"der({name})" for name in model.state_names)]
    names += [*model.parameter_names, *model.outputs, "time"]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        named = f"several variables named {', '.join(twice)}"
        raise ValueError(f"{model.name}: {named}; accepted: a name each ('time' is t)")
    full = given + (0.0,) * (count - len(given))
    nominals = _nominals([max(map(abs, full)) or 1.0] * count if sizes is None else sizes)
    if stop_time is None:
        stop_time = DEFAULT_PERIODS * (abs(model.forcing_period_at(list(parameters))) if model.forced else 1.0)
    return InitialValueProblem(model, model.name, full, parameters, nominals, stop_time, tolerance)


def _start(given: ArrayLike, *counts: int) -> tuple[float, ...]:
    values = numbers("start", given)
    if len(values) not in counts:
        raise ValueError(f"start: given {len(values)} values; accepted: {' or '.join(map(str, sorted(counts)))}")
    return values


# The C of an FMU that depends on its model: equations with their derivatives, and the header config.h -----------------

Pattern = NDArray[np.bool_]
FUNCTION_ROLES = ("derivatives", "outputs", "forward", "adjoint")  # of the generated functions


@dataclass(frozen=True, eq=False)
class Equations:
    """Functions (t, x, p, ...) of a model, all arguments and results dense.

    `derivatives` gives x', `outputs` y, `forward` (with seeds dt, dx, dp) the directional derivatives of both and
    `adjoint` (with seeds of x' and y) their products from the left, shape (1,), (states,), (parameters,).
    """

    model: OdeModel
    identifier: str

    @cached_property
    def both(self) -> ca.Function:
        """Function (t, x, p) -> (x', y)."""
        outputs = list(self.model.outputs.values())
        empty = type(self.model.state)(0, 1)
        values = ca.densify(ca.vertcat(*outputs)) if outputs else empty
        return self.model.function("both", ca.densify(self.model.full_rhs), values)

    @cached_property
    def functions(self) -> tuple[ca.Function, ...]:
        """The functions that are generated, each named with the identifier of the model."""
        kind = type(self.model.state)
        t, x, p = (kind.sym(name, self.both.size1_in(i)) for i, name in enumerate("txp"))
        xdot, y = self.both.call([t, x, p], True, False)
        dt, dx, dp = (kind.sym(f"d{name}", self.both.size1_in(i)) for i, name in enumerate("txp"))
        forward = self.both.forward(1).call([t, x, p, xdot, y, dt, dx, dp], True, False)
        sx, sy = kind.sym("sx", xdot.numel()), kind.sym("sy", y.numel())
        adjoint = self.both.reverse(1).call([t, x, p, xdot, y, sx, sy], True, False)
        return (
            self._function("derivatives", [t, x, p], [xdot]),
            self._function("outputs", [t, x, p], [y]),
            self._function("forward", [t, x, p, dt, dx, dp], forward),
            self._function("adjoint", [t, x, p, sx, sy], adjoint),
        )

    def _function(self, name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
        whole = f"{self.identifier}_equations_{name}"  # no name of the interface ends so
        return ca.Function(whole, arguments, [ca.densify(result) for result in results])

    @cached_property
    def depends(self) -> Pattern:
        """Which of x', y depend on which of t, x, p; shape (states + outputs, 1 + states + parameters)."""
        blocks = [[_pattern(self.both.jac_sparsity(i, j)) for j in range(3)] for i in range(2)]
        return np.block(blocks)

    def source(self) -> str:
        """C99 of all functions; raises ValueError where CasADi cannot generate it, as for a model that is a program."""
        return c_source(f"{self.identifier}_equations", self.functions)


def _pattern(sparsity: ca.Sparsity) -> Pattern:
    dense = np.zeros(sparsity.shape, dtype=bool)
    dense[tuple(np.array(sparsity.get_triplet(), dtype=int))] = True
    return dense


# Jumps --------------------------------------------------------------------------------------------------------------


def check_smooth(problem: InitialValueProblem) -> None:
    """Raises ValueError, naming the variable and the operation, for equations that jump in time, states or inputs.

    An FMU would report events there, at which a solver stops; those of casadi_skin have none.
    """
    model = problem.model
    held = len(model.parameter_names) - len(problem.inputs)
    rates = ca.vertsplit(ca.densify(model.full_rhs))
    named = {f"der({name})": rate for name, rate in zip(model.state_names, rates, strict=True)} | dict(model.outputs)
    names = ["t"], model.state_names, model.parameter_names

    def source(argument: int, index: int) -> int:
        return (TIME, STATE, INPUT if index >= held else 0)[argument]

    if not _jumps(switches(model.function("every", *named.values()), names, source)[1]):
        return
    for name, expression in named.items():
        found = _jumps(switches(model.function("f", expression), names, source)[1])
        if found:
            where = f"{name} has {found[0]} in it, where it jumps, and FMUs are exported without events"
            accepted = "smooth equations, without if_else, comparisons, sign, floor, ceil, fmod, remainder and copysign"
            raise ValueError(f"{model.name}: {where}; accepted: {accepted}")


def _jumps(found: Sequence[Switch]) -> list[str]:
    """Names of operations that jump, if_else before the comparison in it."""
    names = {switch.name for switch in found} & set(OPERATION_NAMES.values())
    return sorted(names, key=lambda name: name != "if_else")


# The header ---------------------------------------------------------------------------------------------------------


def config_header(problem: InitialValueProblem, equations: Equations, token: str) -> str:
    """The text of config.h; the token distinguishes this model from others, in FMI calls and in serialised states."""
    functions, model = equations.functions, problem.model
    bounds = [problem.bounds.get(name, (-math.inf, math.inf)) for name in model.parameter_names]
    arrays = {"START_STATES": problem.start, "NOMINALS": problem.nominals, "START_PARAMETERS": problem.parameters}
    arrays |= {"PARAMETER_MIN": tuple(low for low, _ in bounds), "PARAMETER_MAX": tuple(high for _, high in bounds)}
    words = {size: max(1, *(getattr(f, size)() for f in functions)) for size in ("sz_arg", "sz_res", "sz_iw", "sz_w")}
    words |= {"states": model.full_size, "parameters": len(problem.parameters), "inputs": len(problem.inputs)}
    return with_words(
        (SOURCES / "config_template.h").read_text(encoding="utf-8"), **words, outputs=len(model.outputs), token=token,
        tolerance=repr(problem.tolerance), prototypes="\n".join(f"{prototype(f)};" for f in functions),
        **{f"equations_{role}": f.name() for role, f in zip(FUNCTION_ROLES, functions, strict=True)},
        arrays="\n".join(_array(name, values) for name, values in arrays.items()),
    )  # fmt: skip


def _array(name: str, values: Iterable[float]) -> str:
    """A constant array with one element more than there are values: C has no empty one."""
    words = [repr(float(value)).replace("inf", "HUGE_VAL") for value in values] + ["0"]
    lines = [", ".join(words[i : i + 5]) for i in range(0, len(words), 5)]
    return f"static const double {name}[{len(words)}] = {{\n    " + ",\n    ".join(lines) + "};"
