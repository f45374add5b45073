"""The header config.h of an FMU: sizes, start values and names of the generated functions."""

from __future__ import annotations

import math
from collections.abc import Iterable

from casadi_skin.export.fmu.equations import Equations
from casadi_skin.export.fmu.initial_value_problem import Subject

_ROLES = ("derivatives", "outputs", "forward", "adjoint")


def config_header(subject: Subject, equations: Equations, token: str) -> str:
    """The text of config.h; the token tells this model from others, in FMI calls and in serialised states."""
    functions = equations.functions()
    model = subject.model
    unlimited = (-math.inf, math.inf)
    bounds = [subject.bounds.get(name, unlimited) for name in model.parameter_names]
    lines = [
        "/* What the interface has to know of this model; written by casadi_skin. */",
        "#ifndef CONFIG_H",
        "#define CONFIG_H",
        "",
        f'#define INSTANTIATION_TOKEN "{token}"',
        f"#define DEFAULT_TOLERANCE {subject.tolerance!r}",
        "",
        "/* Numbers of states, parameters and outputs that are no states; sizes of the work arrays. */",
        f"enum {{ NX = {model.full_size}, NP = {len(subject.parameters)}, NY = {len(model.outputs)} }};",
        f"enum {{ SZ_ARG = {_most(f.sz_arg() for f in functions)}, SZ_RES = {_most(f.sz_res() for f in functions)}, "
        f"SZ_IW = {_most(f.sz_iw() for f in functions)}, SZ_W = {_most(f.sz_w() for f in functions)} }};",
        "",
        "typedef long long int casadi_int;",
        *(
            f"int {f.name()}(const double **arg, double **res, casadi_int *iw, double *w, int memory);"
            for f in functions
        ),
        *(f"#define MODEL_{role.upper()} {f.name()}" for role, f in zip(_ROLES, functions, strict=True)),
        "",
        _array("START_STATES", subject.start),
        _array("NOMINALS", [subject.nominal] * model.full_size),
        _array("START_PARAMETERS", subject.parameters),
        _array("PARAMETER_MIN", [low for low, _ in bounds]),
        _array("PARAMETER_MAX", [high for _, high in bounds]),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _most(sizes: Iterable[int]) -> int:
    return max(1, *sizes)


def _array(name: str, values: Iterable[float]) -> str:
    """A constant array with one element more than there are values: C knows no empty one."""
    words = [_literal(value) for value in values] + ["0"]
    lines = [", ".join(words[i : i + 5]) for i in range(0, len(words), 5)]
    return f"static const double {name}[{len(words)}] = {{\n    " + ",\n    ".join(lines) + "};"


def _literal(value: float) -> str:
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))
