"""A field as a program with its own derivatives, as an FMU has them."""

from __future__ import annotations

from typing import Any

import casadi as ca


class Program(ca.Callback):  # type: ignore[misc]
    """Evaluates a function out of CasADi's sight, and its Jacobian when asked: a program too where `orders` is 1.

    CasADi derives nothing by differences: without an order left there is no derivative.
    """

    def __init__(self, function: ca.Function, orders: int | None = None) -> None:
        super().__init__()
        self._function, self._orders = function, orders
        self.construct("field", {"enable_fd": False})

    def get_n_in(self) -> int:
        return int(self._function.n_in())

    def get_n_out(self) -> int:
        return int(self._function.n_out())

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._function.sparsity_in(i)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._function.sparsity_out(i)

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return list(self._function.call(arguments))

    def has_jacobian(self) -> bool:
        return self._orders != 0

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        arguments = self._function.mx_in()
        value = self._function(*arguments)
        derivatives = [ca.densify(ca.jacobian(value, argument)) for argument in arguments]
        if self._orders is not None:
            self._jacobian = Program(ca.Function("derivatives", arguments, derivatives), self._orders - 1)
            derivatives = self._jacobian.call(arguments)
        result = ca.MX.sym("result", value.shape)
        return ca.Function(name, [*arguments, result], derivatives, inames, onames)
