"""Common results, errors and starts of all integrators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.ode import OdeModel

LONGEST = 1e8  # radians that may be followed: a thousand times 10^4 periods of a chain
NOT_FINITE = "it is not finite then"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the requested times, shape (time, 2n), evaluations of the forces, and the step where it is fixed."""

    states: Array
    evaluations: int
    step: float | None = None


class IntegrationError(ArithmeticError):
    """An integrator gave up: the message says where and why in one line, `trajectory` holds the states before that."""

    def __init__(self, method: str, reason: str, trajectory: Trajectory, t: Array, origin: float = 0.0) -> None:
        count = len(trajectory.states)
        reached = t[count - 1] if count else origin
        super().__init__(f"{method}: the state was followed to t = {reached:.6g} of {t[-1]:.6g}: {reason}")
        self.reason, self.trajectory = reason, trajectory


Integrator = Callable[[OdeModel, Array, Array, Array, float], Trajectory]


def finite_trajectory(method: str, trajectory: Trajectory, t: Array, origin: float = 0.0) -> Trajectory:
    """The trajectory; raises IntegrationError where a state is missing or not finite."""
    finite = np.append(np.all(np.isfinite(trajectory.states), axis=1), False)
    count = int(np.argmin(finite))
    if count < t.size:
        whole = Trajectory(trajectory.states[:count], trajectory.evaluations, trajectory.step)
        raise IntegrationError(method, NOT_FINITE, whole, t, origin)
    return trajectory


def fastest_frequency(model: OdeModel, parameters: Array, start: Array, end: float) -> float:
    """Bound of the largest frequency or rate at the start and at rest, from the row sums of df/dx at time 0.

    Raises ValueError where `end` is out of reach of any integrator.
    """
    slope, fastest = model.function("slope", ca.jacobian(model.rhs, model.state)), 0.0
    for x in (start, np.zeros(start.size)):
        jacobian = ca.DM(slope(0.0, x, parameters))
        rows = np.array(jacobian.sparsity().row(), dtype=int)
        sums = np.bincount(rows, np.abs(jacobian.nonzeros()), minlength=model.size)
        if x is start or np.all(np.isfinite(sums)):  # a model need not be defined at rest
            fastest = max(fastest, float(sums.max()))
    frequency = float(np.sqrt(fastest)) if model.order == 2 else fastest
    if not frequency * end <= LONGEST:
        radians = f"{frequency * end:.2g} radians of the fastest vibration"
        raise ValueError(f"t: given up to {end:.6g}, which is {radians} at the start; accepted: up to {LONGEST:g}")
    return frequency or 1.0


def size_of(start: Array) -> float:
    """Largest component, to which tolerances are relative; 1 at rest."""
    return float(np.abs(start).max()) or 1.0
