"""Formulas in scenes: what they mean, and where and why others are refused."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casadi_skin.model.expressions import antiderivative, expression
from casadi_skin.model.formula import DEEPEST_FORMULA, FUNCTIONS, LONGEST_FORMULA, FormulaError, parse_formula

NAMES = {"y": 0.7, "alpha": 1.5, "g": -0.4}


def value(text: str) -> float:
    """A formula at the values of NAMES."""
    return float(expression(parse_formula(text), {name: ca.SX(number) for name, number in NAMES.items()}))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("alpha*y + g*y^3", 1.5 * 0.7 - 0.4 * 0.7**3),
        ("-y^2", -(0.7**2)),
        ("2^3^2", 512.0),
        ("2^-1", 0.5),
        ("1 - 2 - 3", -4.0),
        ("8/4/2", 1.0),
        ("--y + +1", 1.7),
        (".5e1*(1. + y)", 8.5),
        ("2*pi", 2 * math.pi),
        ("(y\n + 1)\t*2 ", 3.4),
        *((f"{name}(y)", getattr(math, {"asin": "asin", "abs": "fabs"}.get(name, name))(0.7)) for name in FUNCTIONS),
    ],
)
def test_values(text: str, expected: float) -> None:
    assert value(text) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "given the end"),
        ("(1+y", 5, "accepted: an operator (+ - * / ^) or )"),
        ("y**2", 3, "accepted: ^ for powers"),
        ("y $ 2", 3, 'given "$"'),
        ("2 y", 3, "accepted: an operator"),
        ("sin y", 1, "accepted: sin(...)"),
        ("  foo(y)", 3, 'the function "foo"; accepted: sin, cos'),
        ("__import__('os')", 1, 'the function "__import__"'),
        ("y.real", 2, 'given "."'),
        ("y if y else y", 3, "accepted: an operator"),
        ("lambda: 0", 7, 'given ":"'),
        ("1e999", 1, "accepted: a finite number"),
        ("y + \N{GREEK SMALL LETTER ALPHA}", 5, "accepted: a finite number, a name"),
        ("y\x00", 2, "\\x00"),
        (
            "(" * (DEEPEST_FORMULA + 1) + "y" + ")" * (DEEPEST_FORMULA + 1),
            DEEPEST_FORMULA + 1,
            f"at most {DEEPEST_FORMULA}",
        ),
        ("-" * 10_00 + "y", DEEPEST_FORMULA + 1, f"at most {DEEPEST_FORMULA}"),
        ("y" + "+y" * LONGEST_FORMULA, LONGEST_FORMULA + 1, f"accepted: {LONGEST_FORMULA} characters"),
    ],
)
def test_refusals_have_the_column(text: str, column: int, words: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse_formula(text)
    message = str(caught.value)
    assert message.startswith(f"column {column}: given")
    assert words in message
    assert "\n" not in message


def test_unknown_names_have_the_nearest_known_one() -> None:
    with pytest.raises(FormulaError, match=r'^column 5: given the name "alhpa"; .*did you mean alpha\?'):
        parse_formula("y + alhpa").check_names(["y", "alpha"])


@given(st.text(max_size=40) | st.text(alphabet="0123456789.eyg()+-*/^ sincoexp", max_size=40))
def test_any_text_is_a_formula_or_refused_in_one_line(text: str) -> None:
    refusal, formula = "column 1", None
    try:
        formula = parse_formula(text)
    except FormulaError as error:
        refusal = str(error)
    assert refusal.startswith("column ")
    assert "\n" not in refusal
    if formula is not None:
        expression(formula, {name: ca.SX.sym(name) for name in formula.names})


@pytest.mark.parametrize(
    "text",
    [
        "alpha*y + g*y^3", "y*(1 + y)^2", "sin(2*y)/3 - g*exp(-y)", "(1 + y)^1.5 - 1", "alpha/(1 + y)", "sqrt(1 + y)",
        "tanh(y) + 3*log(1 + alpha*y)", "cos(g)*(sinh(y) + cosh(y) - tan(y))", "atan(y) + asin(y/2) - acos(y/2)",
        "abs(y)", "-exp(alpha)", "(y^3 + y)*2",
    ],
)  # fmt: skip
def test_antiderivatives_agree_with_quadrature(text: str) -> None:
    formula = parse_formula(text)
    integral = antiderivative(formula, "y")
    others = [NAMES[name] for name in formula.names if name != "y"]
    nodes, weights = np.polynomial.legendre.leggauss(30)
    points = 0.35 * (nodes + 1.0)
    values = [float(expression(formula, {k: ca.SX(v) for k, v in (NAMES | {"y": x}).items()})) for x in points]
    assert float(integral(0.7, *others)) == pytest.approx(0.35 * weights @ values, rel=1e-13)
    assert float(integral(0.0, *others)) == 0.0


@pytest.mark.parametrize("text", ["sin(y^2)", "sin(y)*cos(y)", "y^y", "exp(y)/y", "(1 + y)^-1"])
def test_no_antiderivative_is_made_up(text: str) -> None:
    assert antiderivative(parse_formula(text), "y") is None
