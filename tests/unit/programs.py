"""A field as a program with its own derivatives, as an FMU has them."""

from __future__ import annotations

from typing import Any

import casadi as ca


class Program(ca.Callback):  # type: ignore[misc]
    """Evaluates a function of two arguments out of CasADi's sight, and its Jacobian when asked."""

    def __init__(self, function: ca.Function) -> None:
        super().__init__()
        self._function = function
        self.construct("field", {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._function.sparsity_in(i)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._function.sparsity_out(i)

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return [self._function(*arguments)]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        arguments = self._function.mx_in()
        value = self._function(*arguments)
        derivatives = [ca.densify(ca.jacobian(value, argument)) for argument in arguments]
        result = ca.MX.sym("result", value.shape)
        return ca.Function(name, [*arguments, result], derivatives, inames, onames)
