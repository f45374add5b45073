"""Functions at many places by lists of numbers: the bits are those of CasADi's own map."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone

from casadi_skin.native.places import TOGETHER, at_places
from casadi_skin.zero.problem import Buffers


def some_function(kind: type = ca.SX) -> ca.Function:
    """Sparse and dense results, numbers, results that are arguments or zero, and operations of all kinds."""
    s, x, p = kind.sym("s"), kind.sym("x", 3), kind.sym("p", 2)
    values = ca.vertcat(
        x[0] * x[1] + 2 * x[2] ** 2 - x[0] / p[0],
        ca.sin(s * x[0]) + ca.exp(-x[1]) + ca.log(1.0 + x[2] ** 2),
        ca.if_else(x[0] < p[1], x[1], ca.sqrt(p[0])) + ca.fmax(x[2], x[0]) ** 2.5 + 0.3,
        ca.tanh(x[0] - x[1]) * ca.cos(s),
    )
    unused = ca.vertcat(x[2], kind(0), p[1])
    return ca.Function(
        "some", [s, x, p], [values, ca.jacobian(values, x), ca.densify(unused), ca.jacobian(values[:1], p)]
    )


@needs_kernels
@pytest.mark.parametrize("count", [2, TOGETHER, TOGETHER + 1, 5 * TOGETHER - 3])
def test_the_bits_are_those_of_a_map(count: int) -> None:
    random, function = np.random.default_rng(count), some_function()
    found = Buffers(function, count)
    with numpy_alone():
        mapped = Buffers(function, count)
    for _ in range(2):
        s, x, p = random.normal(size=(count, 1)), random.normal(size=(count, 3)), random.uniform(1.0, 2.0, size=2)
        for one, other in zip(found(s, x, p), mapped(s, x, p), strict=True):
            assert one.size > 0
            np.testing.assert_array_equal(one, other)


@needs_kernels
def test_programs_that_are_no_operations_are_left_to_casadi() -> None:
    x = ca.SX.sym("x")
    for function in (some_function(ca.MX), ca.Function("f", [x], [ca.remainder(x, 2.0)])):
        arguments = [np.ones((4, function.nnz_in(i))) for i in range(function.n_in())]
        results = [np.zeros(4 * function.nnz_out(i)) for i in range(function.n_out())]
        assert at_places(function, arguments, results, 4) is None
        assert all(np.all(np.isfinite(found)) for found in Buffers(function, 4)(*arguments))
