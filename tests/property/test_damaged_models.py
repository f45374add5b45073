"""A damaged file of a model is refused in one line, or read as what it says: no crash, no hang, no other equations."""

from __future__ import annotations

import json
import math
import random
import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel
from casadi_skin.model.saved import checksum, dumps, loads

LONGEST = 5.0  # seconds that reading may take
POINT = 0.37
# What the words of a file mean, by Python's own functions, and nan where these refuse.
MEANINGS: dict[str, Callable[..., float]] = {
    "neg": lambda a: -a, "exp": math.exp, "log": math.log, "sqrt": math.sqrt, "sq": lambda a: a * a,
    "twice": lambda a: 2.0 * a, "sin": math.sin, "cos": math.cos, "tan": math.tan, "asin": math.asin,
    "acos": math.acos, "atan": math.atan, "sinh": math.sinh, "cosh": math.cosh, "tanh": math.tanh,
    "asinh": math.asinh, "acosh": math.acosh, "atanh": math.atanh, "floor": math.floor, "ceil": math.ceil,
    "fabs": math.fabs, "sign": lambda a: float(np.sign(a)), "erf": math.erf, "inv": lambda a: 1.0 / a,
    "not": lambda a: float(not a), "log1p": math.log1p, "expm1": math.expm1, "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b, "pow": math.pow,
    "constpow": math.pow, "lt": lambda a, b: float(a < b), "le": lambda a, b: float(a <= b),
    "eq": lambda a, b: float(a == b), "ne": lambda a, b: float(a != b), "and": lambda a, b: float(bool(a and b)),
    "or": lambda a, b: float(bool(a or b)), "fmod": math.fmod, "remainder": math.remainder, "copysign": math.copysign,
    "if_else_zero": lambda a, b: b if a else 0.0, "fmin": min, "fmax": max, "atan2": math.atan2, "hypot": math.hypot,
}  # fmt: skip


def valid() -> list[str]:
    t, x, p = ca.SX.sym("t"), ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    force = ca.if_else(x[0] > p[0], ca.sin(x[1]) ** 2, ca.fmax(x[2], -0.5)) + ca.sqrt(1 + x[0] ** 2) * ca.cos(t)
    forced = OdeModel(
        "forced", x, ca.vertcat(x[1], force, -p[1] * x[2] + ca.tanh(x[0])), p, time=t, forcing_period=2 * np.pi / p[0],
        outputs={"work": force * x[1], "rest": ca.SX(0)}, nominal=(1.5, 0.1),
    )  # fmt: skip
    q, v, k = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("k")
    chain = OdeModel(
        "chain", q, ca.vertcat(q[1] - 2 * q[0] - k * q[0] ** 3, q[0] - 2 * q[1] - k * q[1] ** 3), k, 2, v,
        reversal=(1, 1, -1, -1), half_period=(-1,) * 4,
        hamiltonian=ca.sumsqr(v) / 2 + ca.sumsqr(q) - q[0] * q[1] + k * (q[0] ** 4 + q[1] ** 4) / 4,
    )  # fmt: skip
    return [dumps(forced), dumps(chain)]


# Damage ---------------------------------------------------------------------------------------------------------------


def changed(text: str, draw: random.Random) -> str:
    """One to five characters replaced, removed, added or with a bit the other way."""
    characters = list(text)
    for _ in range(draw.randint(1, 5)):
        at = draw.randrange(len(characters))
        kind = draw.randrange(4)
        characters[at] = (
            chr(draw.choice([draw.randrange(32, 127), draw.randrange(0x110000 - 2048) % 0xD800])),
            "",
            characters[at] + draw.choice('0123456789-.,:"[]{} eE'),
            chr(ord(characters[at][:1] or " ") ^ 1 << draw.randrange(7)),
        )[kind]
    return "".join(characters)


def truncated(text: str, draw: random.Random) -> str:
    return text[: draw.randrange(len(text))]


def with_other_number(text: str, draw: random.Random) -> str:
    """One number of the text replaced by a huge one, by NaN, by a fraction or by another integer."""
    places = [i for i, c in enumerate(text) if c.isdigit() and not text[i - 1].isalnum()]
    at = draw.choice(places)
    end = next(i for i in range(at, len(text) + 1) if i == len(text) or not text[i].isalnum())
    other = draw.choice(["1e999", "-1e999", "NaN", "Infinity", "9" * 400, "9" * 5000, "-1", "1.5", "null", "true",
                         "1e308", str(draw.randrange(40)), "1" + "0" * 20, "0x1", "1_0", "01"])  # fmt: skip
    return text[:at] + other + text[end:]


def with_doubled_key(text: str, draw: random.Random) -> str:
    lines = text.splitlines()
    at = draw.choice([i for i, line in enumerate(lines) if '": ' in line and line.endswith(",")])
    return "\n".join([*lines[: at + 1], lines[at], *lines[at + 1 :]])


def nested(text: str, draw: random.Random) -> str:
    """A value inside thousands of brackets."""
    depth, at = draw.choice([3, 2000, 100_000]), draw.choice([i for i, c in enumerate(text) if c in "[{"])
    pair = draw.choice([("[", "]"), ('{"a":', "}")])
    return text[:at] + pair[0] * depth + text[at:] + (pair[1] * depth if draw.random() < 0.5 else "")


def other_data(text: str, draw: random.Random) -> str:
    """Well-formed, but other names, operations, entries or declarations."""
    data = json.loads(text)
    model = data["model"]
    key = draw.choice([*model, "operations", "operations", "results", "results"])
    if key == "operations":
        at = draw.randrange(len(model[key]))
        words = model[key][at].split(" ")
        words[draw.randrange(len(words))] = draw.choice([*MEANINGS, "const", "call", "nan", "inf", "", "-0.0",
                                                         *map(str, range(-1, 60))])  # fmt: skip
        model[key][at] = " ".join(words)
    elif key == "results":
        name = draw.choice(list(model[key]))
        if draw.random() < 0.3:
            model[key][draw.choice(["rhs", "normalisation", "output \n", "", "nothing"])] = model[key].pop(name)
        else:
            model[key][name][draw.randrange(len(model[key][name]))] = draw.choice([None, -1, 0, 3, 10**6, 10**30, "x"])
    else:
        model[key] = draw.choice([None, [], {}, "", "a\nb", 3, -1, True, 1e308, [1, -1], ["x", "x"], ["", "\u202e"]])
    return json.dumps(data)


DAMAGES = (changed, changed, truncated, with_other_number, with_doubled_key, nested, other_data, other_data, other_data)


def with_its_checksum(text: str) -> str:
    """As somebody would write it who means harm."""
    try:
        data = json.loads(text)
        return json.dumps(data | {"sha256": checksum(data["model"])})
    except (ValueError, TypeError, KeyError, RecursionError):
        return text


# What is read ---------------------------------------------------------------------------------------------------------


def by_hand(data: dict[str, Any], model: OdeModel) -> list[float]:
    """The right-hand side that a file says, at a point, evaluated one operation after the other."""
    known = [POINT] * (1 + model.full_size + model.parameters.numel())
    for text in data["operations"]:
        name, *words = text.split(" ")
        try:
            value = float(words[0]) if name == "const" else MEANINGS[name](*(known[int(word)] for word in words))
        except (ValueError, OverflowError, ZeroDivisionError):
            value = math.nan
        known.append(value)
    return [0.0 if entry is None else known[entry] for entry in data["results"]["rhs"]]


def check(text: str) -> bool:
    """Whether the text was read; raises AssertionError where it was, and as something else."""
    begun = time.perf_counter()
    try:
        model = loads(text, "model.json")
    except ValueError as error:
        message = str(error)
        assert message.startswith("model.json: not a model saved by casadi_skin: ")
        assert message.isprintable()  # so also one line
        assert len(message) < 500
        return False
    finally:
        assert time.perf_counter() - begun < LONGEST
    data = json.loads(text)["model"]
    assert (model.name, list(model.parameter_names)) == (data["name"], data["parameters"])
    assert (model.order, list(model.state_names)) == (data["order"], data["states"])
    for key in ("reversal", "half_period", "output_scale", "nominal"):
        assert getattr(model, key) == (None if data[key] is None else tuple(data[key]))
    right = np.array(by_hand(data, model))
    given = np.array(
        model.function("f", ca.densify(model.rhs))(POINT, *(np.full(n, POINT) for n in sizes(model)))
    ).ravel()
    known = np.isfinite(right)
    np.testing.assert_allclose(given[known], right[known], rtol=1e-9, atol=1e-12)
    return True


def sizes(model: OdeModel) -> tuple[int, int]:
    return model.full_size, int(model.parameters.numel())


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_damaged_model_is_refused_in_one_line_or_read_as_what_it_says(count: int) -> None:
    texts, read = valid(), 0
    assert all(check(text) for text in texts)
    for seed in range(count):
        draw = random.Random(seed)
        text = draw.choice(DAMAGES)(draw.choice(texts), draw)
        read += check(with_its_checksum(text) if draw.random() < 0.7 else text)
    assert 0.05 * count < read < 0.6 * count  # both happen
