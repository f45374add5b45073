"""The C of an FMU that depends on its model: equations with their derivatives, and the header config.h."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.export.codegen import c_source
from casadi_skin.fmu.initial_value_problem import InitialValueProblem
from casadi_skin.model.jumps import INPUT, NAMES, STATE, TIME, Switch, switches
from casadi_skin.model.ode import OdeModel

Pattern = NDArray[np.bool_]
ROLES = ("derivatives", "outputs", "forward", "adjoint")  # of the generated functions


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
        return self.model.function(
            "both", ca.densify(self.model.full_rhs), ca.densify(ca.vertcat(*outputs)) if outputs else empty
        )

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
        return c_source(f"{self.identifier}_equations", self.functions).text


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
    return sorted(
        {switch.name for switch in found if switch.name in NAMES.values()}, key=lambda name: name != "if_else"
    )


# The header ---------------------------------------------------------------------------------------------------------


def config_header(problem: InitialValueProblem, equations: Equations, token: str) -> str:
    """The text of config.h; the token distinguishes this model from others, in FMI calls and in serialised states."""
    functions, model = equations.functions, problem.model
    bounds = [problem.bounds.get(name, (-math.inf, math.inf)) for name in model.parameter_names]
    sizes = {size: max(1, *(getattr(f, size)() for f in functions)) for size in ("sz_arg", "sz_res", "sz_iw", "sz_w")}
    arguments = "(const double **arg, double **res, casadi_int *iw, double *w, int memory)"
    arrays = {
        "START_STATES": problem.start,
        "NOMINALS": problem.nominals,
        "START_PARAMETERS": problem.parameters,
        "PARAMETER_MIN": [low for low, _ in bounds],
        "PARAMETER_MAX": [high for _, high in bounds],
    }
    lines = [
        "/* Sizes and names of this model for the interface; written by casadi_skin. */",
        "#ifndef CONFIG_H\n#define CONFIG_H\n",
        f'#define INSTANTIATION_TOKEN "{token}"',
        f"#define DEFAULT_TOLERANCE {problem.tolerance!r}\n",
        "/* Numbers of states, parameters with the inputs, which are the last, inputs, and outputs that are no states;",
        "   sizes of the work arrays. */",
        f"enum {{ NX = {model.full_size}, NP = {len(problem.parameters)}, NI = {len(problem.inputs)}, "
        f"NY = {len(model.outputs)} }};",
        f"enum {{ {', '.join(f'{name.upper()} = {value}' for name, value in sizes.items())} }};\n",
        "typedef long long int casadi_int;",
        *(f"int {f.name()}{arguments};" for f in functions),
        *(f"#define MODEL_{role.upper()} {f.name()}" for role, f in zip(ROLES, functions, strict=True)),
        "",
        *(_array(name, values) for name, values in arrays.items()),
        "\n#endif\n",
    ]
    return "\n".join(lines)


def _array(name: str, values: Iterable[float]) -> str:
    """A constant array with one element more than there are values: C has no empty one."""
    words = [repr(float(value)).replace("inf", "HUGE_VAL") for value in values] + ["0"]
    lines = [", ".join(words[i : i + 5]) for i in range(0, len(words), 5)]
    return f"static const double {name}[{len(words)}] = {{\n    " + ",\n    ".join(lines) + "};"
