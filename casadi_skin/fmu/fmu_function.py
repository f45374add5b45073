"""An FMU's right-hand side or outputs as a function of CasADi with its Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.fmu.fmu_derivatives import Derivatives
from casadi_skin.fmu.fmu_variables import Array, Pattern

View = memoryview | None  # CasADi gives None for an argument that is zero and for a result that nobody wants


class FmuFunction(ca.Callback):  # type: ignore[misc]
    """(t, x, p) -> derivatives or outputs of an FMU, with their Jacobian."""

    def __init__(self, name: str, derivatives: Derivatives, forced: bool) -> None:
        ca.Callback.__init__(self)
        self.derivatives = derivatives
        self.sizes = (1, len(derivatives.instance.variables.states), len(derivatives.instance.given))
        self._jacobian = _FmuJacobian(f"{name}_jacobian", self, forced)
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.derivatives.size, 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[View], results: Sequence[View]) -> int:
        if results[0]:
            np.frombuffer(results[0])[:] = self.derivatives.value(*_point(arguments, self.sizes))
        return 0

    def has_jacobian(self) -> bool:
        return True

    def has_jac_sparsity(self, oind: int, iind: int) -> bool:
        return True

    def get_jac_sparsity(self, oind: int, iind: int, symmetric: bool) -> ca.Sparsity:
        return self._jacobian.sparsity_out(iind)

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        return self._jacobian


class _FmuJacobian(ca.Callback):  # type: ignore[misc]
    """(t, x, p, result) -> Jacobians by t, x and p."""

    def __init__(self, name: str, function: FmuFunction, forced: bool) -> None:
        ca.Callback.__init__(self)
        self._derivatives, self._sizes, self._forced = function.derivatives, function.sizes, forced
        rows = self._derivatives.size
        self._sparsities = (
            ca.Sparsity.dense(rows, 1) if forced else ca.Sparsity(rows, 1),
            _sparsity(self._derivatives.pattern),
            ca.Sparsity.dense(rows, self._sizes[2]),
        )
        # Second derivatives are differences: only iterations use them, as the Newton matrix of CVODES' sensitivities.
        self.construct(name, {"enable_fd": True})

    def get_n_in(self) -> int:
        return 4

    def get_n_out(self) -> int:
        return 3

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense((*self._sizes, self._derivatives.size)[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._sparsities[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[View], results: Sequence[View]) -> int:
        at, derivatives = _point(arguments, self._sizes), self._derivatives
        choices = derivatives.time_derivative, derivatives.states_jacobian, derivatives.parameters_jacobian
        for result, jacobian in zip(results, choices, strict=True):
            if result:
                np.frombuffer(result)[:] = jacobian(*at)
        return 0


def _point(arguments: Sequence[View], sizes: Sequence[int]) -> tuple[float, Array, Array]:
    """Time, state and parameters of a function's arguments."""
    t, x, p = arguments[0], arguments[1], arguments[2]
    return (
        0.0 if t is None else float(np.frombuffer(t)[0]),
        np.zeros(sizes[1]) if x is None else np.frombuffer(x),
        _array(p) if p is not None else np.zeros(sizes[2]),
    )


def _array(view: View) -> Array:
    return np.frombuffer(view) if view else np.empty(0)


def _sparsity(pattern: Pattern) -> ca.Sparsity:
    rows, columns = np.nonzero(pattern)
    return ca.Sparsity.triplet(*pattern.shape, rows.tolist(), columns.tolist())
