"""Symmetries and conserved quantities that a model declares, evaluated at random points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import casadi as ca
import numpy as np

from casadi_skin.model.equations import Array, Equations

ROUND_OFF = 1e-12  # of the size of the right-hand side


def check_symmetries(model: Equations, trials: int, seed: int) -> None:
    """Raises ValueError naming the first symmetry or conserved quantity that does not hold at random points."""
    kept = {"hamiltonian": model.hamiltonian} if model.hamiltonian is not None else {}
    kept |= {f"conserved {name}": quantity for name, quantity in model.conserved.items()}
    if model.reversal is None and model.half_period is None and not kept:
        return
    x, rhs = model.full_state, model.full_rhs
    rates = [ca.densify(ca.gradient(quantity, x) * rhs) for quantity in kept.values()]
    brackets = [ca.densify(ca.jtimes(rhs, x, g) - ca.jtimes(g, x, rhs)) for g in model.symmetries.values()]
    evaluate = model.function("check", ca.densify(rhs), *rates, *brackets)
    generator = np.random.default_rng(seed)
    for _ in range(trials):
        time, point, parameter = _finite_point(model, evaluate, generator)
        value, *changes = (np.array(r).ravel() for r in _all(evaluate(time, point, parameter)))
        scale = ROUND_OFF * (1.0 + np.abs(value).max())
        half = 0.5 * model.forcing_period_at(parameter)
        images = (("reversal", model.reversal, -1, -time), ("half_period", model.half_period, 1, time + half))
        for label, signs, sense, at in images:
            if signs is None:
                continue
            image = np.array(_all(evaluate(at, np.array(signs) * point, parameter))[0]).ravel()
            if not np.abs(image - sense * np.array(signs) * value).max() <= scale:
                raise ValueError(f"{model.name}: the declared {label} is not a symmetry of the right-hand side")
        within = scale * (1.0 + np.abs(point).sum())
        for label, change in zip(kept, changes, strict=False):
            if not abs(np.sum(change)) <= max(within, ROUND_OFF * np.sum(np.abs(change))):
                raise ValueError(f"{model.name}: the declared {label} is not conserved")
        for label, bracket in zip(model.symmetries, changes[len(kept) :], strict=True):
            if not np.max(np.abs(bracket)) <= within:
                raise ValueError(f"{model.name}: the declared direction {label} is not that of a symmetry")


def _all(results: Any) -> tuple[Any, ...]:
    """All results of a function, also where it has one."""
    return results if isinstance(results, tuple) else (results,)


def _finite_point(
    model: Equations, evaluate: ca.Function, generator: np.random.Generator
) -> tuple[float, Array, Array]:
    """A random time, state and parameter at which all is finite: positive where roots and logarithms need it."""
    time = generator.normal()
    x, p = (generator.normal(size=count) for count in (model.full_size, model.parameters.numel()))
    for point, parameter in ((x, p), (x, np.abs(p)), (np.abs(x), np.abs(p))):
        if all(np.all(np.isfinite(np.array(r))) for r in _all(evaluate(time, point, parameter))):
            return time, point, parameter
    raise ValueError(f"{model.name}: the right-hand side or the hamiltonian is not finite at a random point")


# Whether a right-hand side repeats itself after the declared period of the forcing ------------------------------------

SAME_RATE_RTOL = 1e-7  # of the largest rate
COMPARED_PLACES = 7  # places of a motion
PLACE_FRACTION = 0.382  # of the way between two places: forces like sign(sin t) jump at simple parts of the period


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
    times = length * (np.arange(COMPARED_PLACES) + PLACE_FRACTION) / COMPARED_PLACES
    for t, x in zip(times, motion.evaluate(times), strict=True):
        now, later = (np.array(field(at, x, p)).ravel() for at in (t, t + period))
        if np.max(np.abs(later - now)) > SAME_RATE_RTOL * (1.0 + np.max(np.abs(now))):  # not so where one is no number
            at = ", ".join(f"{name} = {parameters[name]:.6g}" for name in model.parameter_names)
            given = (
                f"forcing_period: given {period:.6g}{f' at {at}' if at else ''}, after which equations do not repeat"
            )
            accepted = "a period after which they do, an expression in the parameters that it depends on"
            raise ValueError(f"{model.name}: {given}; accepted: {accepted}")
