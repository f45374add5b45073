"""The function that Ipopt calls at every iteration: it reports progress and can end the solve."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_skin.zero.problem import Array

Monitor = Callable[[int, float, float], bool]  # (iteration, objective, violation) -> whether to stop


class IterationCallback(ca.Callback):  # type: ignore[misc]  # CasADi has no types
    """Calls a monitor at every iteration of Ipopt, and ends the solve where it returns True or raises.

    `failure` is the exception that the monitor raised: CasADi would report a failed evaluation in its place.
    """

    def __init__(self, unknowns: int, rows: int, parameters: int) -> None:
        ca.Callback.__init__(self)
        sizes = {"x": unknowns, "f": 1, "g": rows, "lam_x": unknowns, "lam_g": rows, "lam_p": parameters}
        self._sizes = [sizes[name] for name in ca.nlpsol_out()]
        self.begin(np.zeros(rows), np.zeros(rows), None)
        self.construct("iteration", {})

    def begin(self, low: Array, high: Array, monitor: Monitor | None) -> None:
        """Prepare for another solve, with these bounds of the constraints."""
        self._low, self._high, self._monitor, self._iteration = low, high, monitor, 0
        self.failure: BaseException | None = None

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1) if self._sizes[i] else ca.Sparsity(0, 0)

    def eval(self, arguments: list[ca.DM]) -> list[int]:
        try:
            return [int(self._monitor is not None and self._stops(dict(zip(ca.nlpsol_out(), arguments, strict=True))))]
        except BaseException as error:
            self.failure = error
            return [1]

    def _stops(self, values: dict[str, ca.DM]) -> bool:
        assert self._monitor is not None
        g = np.array(values["g"]).ravel()
        violation = float(np.max(np.maximum(self._low - g, g - self._high), initial=0.0))
        self._iteration += 1
        return self._monitor(self._iteration - 1, float(values["f"]), violation)
