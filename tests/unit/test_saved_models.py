"""Models in files are data: every example comes back to the last bit, and nothing else than operations is read."""

from __future__ import annotations

import inspect
import json
import math
import os
import pickle
import subprocess
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel
from casadi_skin.model.loading import USER_MODULE_NAME, run_file
from casadi_skin.model.operations import CODES, MOST_DEPTH, MOST_OPERATIONS, ONE_ARGUMENT, from_operations
from casadi_skin.model.saved import checksum, dumps, loads

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted([*EXAMPLES.glob("*.py"), *EXAMPLES.glob("models/*.py")])


def example_models() -> list[OdeModel]:
    """Every model that an example makes when it is imported, or by a function without arguments in examples/models."""
    found = []
    for path in SCRIPTS:
        names = run_file(path, path.read_text(encoding="utf-8"))
        mine = [f for f in names.values() if inspect.isfunction(f) and f.__module__ == USER_MODULE_NAME]
        makers = [f for f in mine if not _needed(f)] if path.parent.name == "models" else []
        found += [v for v in (*names.values(), *(f() for f in makers)) if isinstance(v, OdeModel)]
    return found


def _needed(function: Any) -> list[str]:
    return [n for n, p in inspect.signature(function).parameters.items() if p.default is p.empty]


def equations(model: OdeModel) -> ca.Function:
    more = [e for e in (model.hamiltonian, model.normalisation) if e is not None]
    return model.function("all", model.full_rhs, *model.outputs.values(), *more)


def assert_same(model: OdeModel, again: OdeModel) -> None:
    """All declarations and, at random points, all values to the last bit."""
    for label in ("name", "order", "state_names", "parameter_names", "reversal", "half_period", "nominal", "forced",
                  "output_scale"):  # fmt: skip
        assert getattr(again, label) == getattr(model, label)
    assert list(again.outputs) == list(model.outputs)
    generator, (ours, theirs) = np.random.default_rng(1), (equations(m) for m in (model, again))
    for _ in range(20):
        p = generator.uniform(0.1, 2.0, model.parameters.numel())
        point = (generator.normal(), generator.normal(size=model.full_size), p)
        for one, other in zip(ours.call(point), theirs.call(point), strict=True):
            assert one.sparsity() == other.sparsity()
            assert np.array(one).tobytes() == np.array(other).tobytes()
        assert model.forcing_period_at(p) == again.forcing_period_at(p)


def test_every_example_comes_back_to_the_last_bit() -> None:
    models = example_models()
    assert len(models) >= 9
    for model in models:
        again = loads(dumps(model))
        assert_same(model, again)
        assert_same(model, pickle.loads(pickle.dumps(model)))


def test_every_operation_and_every_number_comes_back_to_the_last_bit() -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    values = [math.inf, -math.inf, math.nan, -0.0, 5e-324, 1.7976931348623157e308, 0.1, 1 / 3, 2.0**53 + 2]
    numbers = [ca.if_else(x > 1e9, ca.SX(value), x) for value in values]
    symbols = [x, p]
    made = [
        ca.SX.unary(code, x) if name in ONE_ARGUMENT else ca.SX.binary(code, *symbols) for name, code in CODES.items()
    ] + [x**0.3]
    every = OdeModel("every", x, -x, p, outputs={f"o{k}": e for k, e in enumerate([*made, *numbers])})
    assert_same(every, loads(dumps(every)))
    assert set(CODES) - {"twice"} <= {line.split(" ")[0] for line in json.loads(dumps(every))["model"]["operations"]}


def test_simplifications_of_casadi_change_no_round_off() -> None:
    """inf * 0 is 0 to CasADi where it builds expressions, and nan where it evaluates them; what is written is read."""
    x = ca.SX.sym("x")
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    product = from_operations([x], ["const 0.0", "mul 0 1"], [[2]])[0]
    assert ca.GlobalOptions.getSimplificationOnTheFly() == before
    assert np.isnan(float(ca.Function("f", [x], [product])(math.inf)))
    assert float(ca.Function("f", [x], [x * ca.SX(0)])(math.inf)) == 0.0


# What cannot be written -----------------------------------------------------------------------------------------------


def test_tables_and_solutions_of_other_equations_are_refused_with_the_reason() -> None:
    x = ca.MX.sym("x")
    table = ca.interpolant("measured", "bspline", [[0.0, 1.0, 2.0, 3.0]], [0.0, 1.0, 4.0, 9.0])
    y = ca.MX.sym("y")
    root = ca.rootfinder("implicit", "newton", {"x": y, "p": x, "g": y**3 + y - x})
    for name, rhs in (("measured", table(x)), ("implicit", root(0, x))):
        model = OdeModel("strange", x, -rhs)
        with pytest.raises(
            ValueError, match=r"^strange: cannot be saved: its equations are not made of elementary"
        ) as error:
            dumps(model)
        assert name in str(error.value)
        assert "\n" not in str(error.value)
        assert float(pickle.loads(pickle.dumps(model)).vector_field(0.0, 1.0, [])) == float(
            model.vector_field(0, 1, [])
        )


def test_a_function_that_is_called_by_scalars_is_refused() -> None:
    x = ca.SX.sym("x")
    inner = ca.Function("kept", [x], [ca.sin(x)], {"never_inline": True})
    with pytest.raises(ValueError, match=r"inner: cannot be saved: its equations are not made of elementary .*: kept"):
        dumps(OdeModel("inner", x, -inner(x)))


# What is never run ----------------------------------------------------------------------------------------------------


def test_a_file_of_the_old_format_loads_no_native_code(tmp_path: Path) -> None:
    """Format 1 held CasADi's serialised functions, which load a library where they call one."""
    marker, library = tmp_path / "loaded", tmp_path / "harm.so"
    code = f"""
        #include <stdio.h>
        __attribute__((constructor)) static void harm(void) {{ fclose(fopen("{marker}", "w")); }}
        int f(const double** arg, double** res, long long* iw, double* w, int mem) {{ return 0; }}
    """
    (tmp_path / "harm.c").write_text(code, encoding="utf-8")
    subprocess.run(
        [os.environ.get("CC", "cc"), "-shared", "-fPIC", str(tmp_path / "harm.c"), "-o", str(library)], check=True
    )
    x = ca.MX.sym("x")
    function = ca.Function("model", [ca.MX.sym("t"), x, ca.MX.sym("p", 0)], [ca.external("f", str(library))(x)])
    old = {"name": "harm", "order": 1, "state_labels": ["x"], "parameter_labels": [], "kind": "MX", "forced": False,
           "results": ["rhs"], "format": "casadi_skin model 1", "equations": function.serialize()}  # fmt: skip
    marker.unlink()  # CasADi ran the library to make the function
    with pytest.raises(
        ValueError, match="format 'casadi_skin model 1'; accepted: a file of format 'casadi_skin model 2'"
    ):
        loads(json.dumps(old))
    assert not marker.exists()


def with_data(**changes: Any) -> str:
    x = ca.SX.sym("x")
    data = json.loads(dumps(OdeModel("line", x, -2 * x)))["model"] | changes
    return json.dumps({"format": "casadi_skin model 2", "sha256": checksum(data), "model": data})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"operations": ["neg 2"]}, "operation 'neg 2'; accepted: a known one of earlier results, up to 1"),
        ({"operations": ["external 0"]}, "operation 'external 0'"),
        ({"operations": ["neg 0 1"]}, "operation 'neg 0 1'"),
        ({"operations": ["add -1 0"]}, "operation 'add -1 0'"),
        ({"operations": ["neg ١"]}, "operation 'neg ١'"),
        ({"operations": ["const 1_0.0"]}, "operation 'const 1_0.0'"),
        ({"operations": ["const 1e5"]}, "operation 'const 1e5'"),
        ({"operations": ["neg " + "9" * 5000]}, "operation 'neg 999"),
        ({"results": {"rhs": [9]}}, "entry 9 of a result; accepted: 0 to 3"),
        ({"results": {"output a": [0]}}, "results: no right-hand side"),
        ({"results": {"rhs": [0], "field": [0]}}, "results: given .'field'."),
        ({"results": {"rhs": [0, 0]}}, "line: rhs: given shape"),
        ({"states": ["a\nb"]}, "as the name of a state or parameter; accepted: names in one line"),
        ({"name": "\x1b[2J"}, "name: given"),
        ({"order": 2}, "line: state: given shape"),
        ({"nominal": [1.0]}, "line: nominal needs 0 values, given 1"),
        ({"reversal": [1]}, "line: the declared reversal is not a symmetry"),
    ],
)
def test_what_is_no_model_is_refused_whatever_its_checksum(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"^text: not a model saved by casadi_skin: .*{words}") as error:
        loads(with_data(**changes))
    assert str(error.value).isprintable()


def test_another_checksum_is_refused() -> None:
    with pytest.raises(ValueError, match="damaged: its checksum is"):
        loads(with_data().replace('"line"', '"pine"'))


@pytest.mark.slow
def test_a_graph_of_many_operations_ends_soon_and_one_of_more_is_refused() -> None:
    begun = time.perf_counter()
    many = 250_000
    model = loads(with_data(operations=[f"add {1 + k % 1000} 1" for k in range(many)], results={"rhs": [many]}))
    assert model.size == 1
    more = with_data(operations=["neg 0"] * (MOST_OPERATIONS + 1))
    with pytest.raises(ValueError, match="1000001 operations; accepted: up to 1000000"):
        loads(more)
    assert time.perf_counter() - begun < 30.0


def test_expressions_that_casadi_cannot_print_are_refused() -> None:
    """What is 13,000 operations deep ends the process where it is printed, on the usual stack of 8 MB."""
    deep = [f"sin {k}" for k in range(1, MOST_DEPTH + 2)]
    with pytest.raises(ValueError, match="5001 operations one upon the other; accepted: up to 5000"):
        loads(with_data(operations=deep, results={"rhs": [1]}))
    x = ca.SX.sym("x")
    rhs = x
    for _ in range(MOST_DEPTH):
        rhs = ca.sin(rhs)
    model = OdeModel("deep", x, rhs)
    assert len(repr(loads(dumps(model)).rhs)) > MOST_DEPTH
    with pytest.raises(ValueError, match="deep: cannot be saved: its equations have 5001 operations one"):
        dumps(OdeModel("deep", x, -rhs))


@pytest.mark.slow
def test_many_states_and_many_outputs_end_soon() -> None:
    count = 9_000
    begun = time.perf_counter()
    outputs = {f"output o{k}": [k + 1] for k in range(count)}
    states = [f"x{k}" for k in range(count)]
    model = loads(with_data(states=states, operations=[], results={"rhs": [*range(1, count + 1)], **outputs}))
    assert len(model.outputs) == count
    assert time.perf_counter() - begun < 20.0
