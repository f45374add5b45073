"""Values and states as a scene gives them, by name or in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.faults import SceneError, check_known, refusal
from casadi_skin.zero.problem import Array

Numbers = Sequence[float] | Mapping[str, float]


def values_of(model: OdeModel, given: Mapping[str, float]) -> dict[str, float]:
    """Values of all parameters of a model by name; raises SceneError."""
    for name in given:
        check_known("[model] parameters", name, model.parameter_names)
    if model.order == 2 and model.normalisation is not None:  # the amplitude's parameter needs no value
        return dict(given)
    from casadi_skin.zero.statement import named_values

    try:
        return named_values(model, given)
    except ValueError as error:
        raise SceneError(f"[model] {error}") from None


def state_of(given: Numbers, names: Sequence[str]) -> Array:
    """A state from a list, or from a table by the names of states; those left out are 0."""
    return np.array([given.get(name, 0.0) for name in names] if isinstance(given, Mapping) else given, dtype=float)


def check_state(place: str, given: Numbers, names: Sequence[str]) -> None:
    """Raises SceneError where a state does not fit these names."""
    if isinstance(given, Mapping):
        for name in given:
            check_known(place, name, names)
    elif len(given) != len(names):
        raise refusal(place, f"a list of {len(given)}", f"{len(names)} numbers: {', '.join(names)}")
