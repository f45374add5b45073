"""The flow over one segment of an orbit by SUNDIALS CVODES, as CasADi callbacks that do not fail but report.

CasADi prints the arguments of a nested call that fails, and a solver that meets an error or a NaN prints a warning for
each; so a state that CVODES cannot follow is returned FAR away, which is where it mostly is, and `failure` says why.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.cvodes import TIGHT_ITERATION, CvodesOptions, cvodes_reason
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.fields import unfolded_field

FAR = 1e20
SENSITIVITY_DIGITS = 8  # Newton's steps then err by 1e-6 of themselves, and cost a quarter of those with 13 digits
MAX_STEPS = 5_000  # in one segment: ten times what steep orbits need with 14 digits

Evaluation = Callable[[ca.DM, ca.DM], list[ca.DM]]


class _Callback(ca.Callback):  # type: ignore[misc]
    """A Python function of (x, parameters) as a CasADi function with results of given shapes."""

    def __init__(
        self,
        name: str,
        sizes: tuple[int, int],
        shapes: list[tuple[int, int]],
        evaluation: Evaluation,
        jacobian: ca.Function | None = None,
    ) -> None:
        ca.Callback.__init__(self)
        self._sizes, self._shapes, self._evaluation, self._jacobian = sizes, shapes, evaluation, jacobian
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return len(self._shapes)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shapes[i])

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return self._evaluation(arguments[0], arguments[1])

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        assert self._jacobian is not None
        arguments = [ca.MX.sym("x", self._sizes[0]), ca.MX.sym("p", self._sizes[1])]
        result = ca.MX.sym("result", *self._shapes[0])
        return ca.Function(name, [*arguments, result], self._jacobian(*arguments), inames, onames)


class SegmentFlow:
    """The state at the end of a segment from that at its start, to a number of digits, and its derivatives.

    Parameters are those of the model, the coefficient of the unfolding damping, and the duration. Local tolerances are
    relative to the largest component of the start.
    """

    def __init__(self, model: OdeModel, digits: int) -> None:
        n, parameters = model.full_size, int(model.parameters.numel()) + 2
        self.failure: str | None = None
        local = 10.0**-digits
        self._flow = _integrator(model, CvodesOptions(local, local, MAX_STEPS, iteration=TIGHT_ITERATION))
        local = 10.0 ** -min(digits, SENSITIVITY_DIGITS)
        loose = _integrator(model, CvodesOptions(local, local, MAX_STEPS, sensitivity_errors=True))
        # The integrator of the sensitivities itself: a call that is not nested in another fails without printing.
        inside = loose.forward(n + parameters).find_functions()
        self._variational = next(f for f in inside if f.class_name() == loose.class_name())
        seeds = ca.DM.eye(n + parameters)
        self._seeds = seeds[:n, :], ca.vertcat(seeds[n:, :], ca.DM(1, n + parameters))
        sizes = (n, parameters)
        self.sensitivities = _Callback("sensitivities", sizes, [(n, n), (n, parameters)], self._sensitivities)
        self.end = _Callback("end", sizes, [(n, 1)], self._end, self.sensitivities)

    def _end(self, x: ca.DM, p: ca.DM) -> list[ca.DM]:
        """The state at the end."""
        scale = _scale(x)
        try:
            return [scale * self._flow(x0=x / scale, p=ca.vertcat(p, scale))["xf"]]
        except RuntimeError as error:
            self.failure = f"cvodes {cvodes_reason(error)}"
            return [x + FAR]

    def _sensitivities(self, x: ca.DM, p: ca.DM) -> list[ca.DM]:
        """Its derivatives with respect to the start, (n, n), and to the parameters, (n, parameters)."""
        scale, (of_start, of_parameters) = _scale(x), self._seeds
        start, parameters = ca.horzcat(x / scale, of_start), ca.horzcat(ca.vertcat(p, scale), of_parameters)
        try:
            derivatives = self._variational(x0=start, p=parameters)["xf"][:, 1:]
        except RuntimeError as error:
            self.failure = f"cvodes {cvodes_reason(error)}"
            return [ca.DM.eye(x.numel()), ca.DM.zeros(x.numel(), p.numel())]
        return [derivatives[:, : x.numel()], scale * derivatives[:, x.numel() :]]


def _integrator(model: OdeModel, options: CvodesOptions) -> ca.Function:
    """CVODES over the unit of time, with parameters (model's, damping, duration, scale of the state)."""
    x, parameters = ca.SX.sym("x", model.full_size), ca.SX.sym("p", model.parameters.numel() + 1)
    duration, scale = ca.SX.sym("duration"), ca.SX.sym("scale")
    rate = duration / scale * ca.densify(unfolded_field(model)(scale * x, parameters)[0])
    dae = {"x": x, "p": ca.vertcat(parameters, duration, scale), "ode": rate}
    return options.integrator("segment", dae, (0.0, 1.0))


def _scale(x: ca.DM) -> float:
    largest = float(ca.mmax(ca.fabs(x)))
    return largest if np.isfinite(largest) and largest > 0 else 1.0
