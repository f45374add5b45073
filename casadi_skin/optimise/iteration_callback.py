"""What watches Ipopt: told of every iteration, it can end the solve."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_skin.theory.linear import Array

Monitor = Callable[[int, float, float], bool]  # (iteration, objective, violation) -> whether to stop


class Watch(ca.Callback):  # type: ignore[misc]  # CasADi has no types
    """Tells a monitor of every iteration of Ipopt, and ends the solve where it says so."""

    def __init__(self, size: int, rows: int, parameters: int, sign: float) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"f": 1, "x": size, "lam_x": size, "g": rows, "lam_g": rows, "lam_p": parameters}
        self._sign = sign
        self.begin(np.zeros(rows), np.zeros(rows), None)
        self.construct("watch", {})

    def begin(self, low: Array, high: Array, monitor: Monitor | None) -> None:
        """Watch another solve, with these bounds of the constraints."""
        self._low, self._high, self._monitor, self._iteration = low, high, monitor, 0

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        return "ret"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        size = self._sizes[ca.nlpsol_out(i)]
        return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

    def eval(self, arguments: list[ca.DM]) -> list[float]:
        if self._monitor is None:
            return [0.0]
        names = [ca.nlpsol_out(i) for i in range(len(arguments))]
        g = np.array(arguments[names.index("g")]).ravel()
        violation = float(np.max(np.maximum(self._low - g, g - self._high), initial=0.0))
        stop = self._monitor(self._iteration, self._sign * float(arguments[names.index("f")]), violation)
        self._iteration += 1
        return [1.0 if stop else 0.0]
