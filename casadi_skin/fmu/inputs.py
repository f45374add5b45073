"""Inputs of an FMU: forces on the sites of a chain, a lattice or a model of second order, and named parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from casadi_skin.fmu.initial_value_problem import InitialValueProblem
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.model.arguments import nearest, short_repr
from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel

MOST_LISTED = 8


@dataclass(frozen=True, eq=False)
class Force:
    """A force on a site: it adds `factor` times itself to the derivative of the state number `row`."""

    row: int
    factor: Expression | float
    meaning: str


def with_inputs(problem: InitialValueProblem, names: object) -> InitialValueProblem:
    """The problem with some numbers as inputs, which are the last of its parameters; forces start from 0.

    Raises:
        TypeError: `names` is no list of names.
        ValueError: A name is neither that of a force nor of a parameter, or is there twice.
    """
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"inputs: given {short_repr(names)}; accepted: a list of names")
    known = dict(zip(problem.model.parameter_names, problem.parameters, strict=True))
    forces = forces_of(problem)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ValueError(f"inputs: given {name!r} twice; accepted: each name once")
        if name not in known and name not in forces:
            near, accepted = nearest(name, [*forces, *known]), sorted([*known, *forces], key=lambda n: n not in known)
            listed = [*([near] if near else []), *(other for other in accepted if other != near)]
            rest = f" and {len(listed) - MOST_LISTED} more" if len(listed) > MOST_LISTED else ""
            words = ", ".join(listed[:MOST_LISTED]) + rest or "none, the model has neither forces nor parameters"
            raise ValueError(f"inputs: given {name!r}; accepted: {words}")
    if not names:
        return problem
    held = [name for name in known if name not in names]
    values = known | dict.fromkeys((name for name in names if name not in known), 0.0)
    chosen = {name: force for name, force in forces.items() if name in names and name not in known}
    model = _forced(problem.model, (*held, *names), chosen)
    return replace(
        problem,
        model=model,
        parameters=tuple(values[name] for name in model.parameter_names),
        inputs=tuple(names),
        meanings=dict(problem.meanings) | {name: force.meaning for name, force in chosen.items()},
    )


def forces_of(problem: InitialValueProblem) -> Mapping[str, Force]:
    """Forces on the sites by name: f_3 acts on y_3; none of a model that is of first order by declaration."""
    model = problem.model
    states = model.state_names
    if isinstance(model, Lattice):
        count, masses = model.declaration.size, ca.vertsplit(model.equations.masses)
        factors: Sequence[Expression | float] = [1.0 / mass for mass in masses]
    elif model.order == 2 or problem.chain:
        count = len(states) // 2
        factors = [1.0] * count
    else:
        return {}
    return {
        f"f_{name.removeprefix('y_')}": Force(count + i, factor, f"force on {name}")
        for i, (name, factor) in enumerate(zip(states[:count], factors, strict=True))
    }


def _forced(model: OdeModel, names: Sequence[str], forces: Mapping[str, Force]) -> OdeModel:
    """The model of first order with its parameters in this order, forces among them."""
    kind, first = type(model.state), model.first_order()
    x, p = kind.sym("x", model.full_size), kind.sym("p", len(names))
    time = kind.sym("t") if model.time is None else model.time
    places = {name: p[i] for i, name in enumerate(names)}
    own = ca.vertcat(*(places[name] for name in model.parameter_names)) if model.parameter_names else kind(0, 1)
    outputs = list(model.outputs.values())
    results = [ca.densify(first.full_rhs), *outputs, *(kind(force.factor) for force in forces.values())]
    found = first.function("unforced", *results).call([time, x, own], True, False)
    rate, factors = found[0], found[1 + len(outputs) :]
    for (name, force), factor in zip(forces.items(), factors, strict=True):
        rate[force.row] += factor * places[name]
    return OdeModel(
        name=model.name,
        state=x,
        rhs=rate,
        parameters=p,
        time=model.time,
        forcing_period=_period(model, own),
        outputs=dict(zip(model.outputs, found[1 : 1 + len(outputs)], strict=True)),
        state_labels=model.state_names,
        parameter_labels=tuple(names),
        checked=False,
    )


def _period(model: OdeModel, own: Expression) -> Expression | float | None:
    """The forcing's period in the new parameters."""
    if not isinstance(model.forcing_period, ca.SX | ca.MX):
        return model.forcing_period
    return ca.Function("T", [model.parameters], [model.forcing_period]).call([own], True, False)[0]
