"""Whether a right-hand side repeats itself after the declared period of the forcing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from casadi_skin.model.equations import Array, Equations

SAME = 1e-7  # of the largest rate
COMPARED = 7  # places of a motion
BESIDE = 0.382  # of the way between two places: forces like sign(sin t) jump at simple parts of the period


class Motion(Protocol):
    def evaluate(self, t: Array) -> Array: ...


def check_forcing_period(model: Equations, motion: Motion, length: float, parameters: Mapping[str, float]) -> None:
    """Compares the right-hand side along a motion with that of one period of the forcing later.

    Arguments:
        model: a model that time drives.
        motion: its first-order states at any time.
        length: the time for which it is looked at.
        parameters: numbers for all parameters, by name.

    Raises:
        ValueError: they differ.
    """
    p = [parameters[name] for name in model.parameter_names]
    period, field = model.forcing_period_at(p), model.function("field", model.full_rhs)
    times = length * (np.arange(COMPARED) + BESIDE) / COMPARED
    for t, x in zip(times, motion.evaluate(times), strict=True):
        now, later = (np.array(field(at, x, p)).ravel() for at in (t, t + period))
        if np.max(np.abs(later - now)) > SAME * (1.0 + np.max(np.abs(now))):  # not so where one is no number
            at = ", ".join(f"{name} = {parameters[name]:.6g}" for name in model.parameter_names)
            given = (
                f"forcing_period: given {period:.6g}{f' at {at}' if at else ''}, after which equations do not repeat"
            )
            accepted = "a period after which they do, an expression in the parameters that it depends on"
            raise ValueError(f"{model.name}: {given}; accepted: {accepted}")
