"""The family of one linear mode of a second-order model, with its parameters free.

The model is odd, q -> -q, and reversible with even positions, so that its equilibrium is at 0 and its orbits are sums
of odd cosines. Displacements are y = sqrt(S) q.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.ode import OdeModel
from casadi_skin.optimise.observables import QUANTITIES, RESERVED, FamilyEquations, FreeNumber, Observables
from casadi_skin.zero.problem import Array
from casadi_skin.zero.request import FamilyRequest
from casadi_skin.zero.statement import named_values


@dataclass(frozen=True, eq=False)
class ModelFamily:
    """One mode's family of a model, by ascending linear frequency from 1, with the interface of `ChainFamily`.

    `values` are those of all parameters.
    """

    model: OdeModel
    mode: int = 1
    values: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, model: OdeModel, mode: int | str | None, parameters: Mapping[str, float] | None) -> ModelFamily:
        """By default of the first mode; raises ValueError for a model without such families, or a mode it has not."""
        even = model.reversal == (1,) * model.size + (-1,) * model.size
        if model.order != 2 or not even or model.half_period != (-1,) * model.full_size or model.forced:
            accepted = "a guess of an orbit, or a model of second order that declares reversal with even positions and "
            raise ValueError(f"guess: given none for {model.name}; accepted: {accepted}half_period with all signs -1")
        if model.normalisation is not None:
            accepted = "a model without: S is the sum of squares"
            raise ValueError(f"normalisation: given with {model.name}; accepted in a search: {accepted}")
        energy = () if model.hamiltonian is None else ("energy", "energy_slope")
        reserved = {*QUANTITIES, *RESERVED} - {"energy", "energy_slope"} | set(energy)
        for name in (*model.parameter_names, *model.outputs):
            if name in reserved:
                raise ValueError(f"{model.name}: given a parameter or output called {name}; accepted: other names")
        values = named_values(model, parameters)
        number = FamilyRequest(model, 1 if mode is None else mode, 1.0, parameters=values).mode
        return cls(model, int(number), values)

    def __reduce__(self) -> tuple[Any, ...]:
        return ModelFamily, (self.model, self.mode, dict(self.values))

    @property
    def size(self) -> int:
        return self.model.size

    @property
    def columns(self) -> tuple[str, ...]:
        return self.model.parameter_names

    @property
    def free(self) -> Mapping[str, FreeNumber]:
        return {name: FreeNumber(value, -math.inf, math.inf, (name,)) for name, value in self.values.items()}

    def limited(self, bounds: Mapping[str, tuple[float, float]]) -> ModelFamily:
        return self

    def equations(self, values: Mapping[str, ca.SX], S: ca.SX) -> FamilyEquations:
        model, q, scale = self.model, ca.SX.sym("q", self.model.size), ca.sqrt(S)
        parameters = ca.vertcat(*(values.get(name, ca.SX(value)) for name, value in self.values.items()))
        energy = [] if model.hamiltonian is None else [model.hamiltonian]
        function = model.function("at_rest", model.rhs, *model.outputs.values(), *energy)
        rest = ca.vertcat(scale * q, ca.SX.zeros(model.size))
        rhs, *others = function.call([0.0, rest, parameters], True, False)
        outputs = dict(zip(model.outputs, others, strict=False))

        return FamilyEquations(
            state=q,
            S=S,
            acceleration=rhs / scale,
            weights=ca.SX.ones(model.size),
            energy=others[-1] if energy else None,
            shared=dict(zip(self.values, ca.vertsplit(parameters), strict=True)) if self.values else {},
            own={name: partial(Observables.at_rest, expression=e) for name, e in outputs.items()},
        )

    def at(self, values: Mapping[str, Any]) -> OdeModel:
        nominal = tuple(float(values.get(name, value)) for name, value in self.values.items())
        return self.model.with_nominal(nominal)

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        return np.full(self.size, math.sqrt(S))

    def plain(self, values: Mapping[str, Any], S: float) -> tuple[OdeModel, float]:
        return _scaled(self, tuple(sorted(values.items()))), S

    def members(self, values: Mapping[str, Any], amplitudes: Sequence[float], tolerance: float) -> list[Orbit]:
        at = sorted(set(amplitudes))
        branch = follow_family(self.at(values), self.mode, at[-1], at=at, tolerance=tolerance, corrector="newton")
        return [branch.at(S=S) for S in amplitudes]

    def nodes(self, orbit: Orbit, theta: Array) -> Array:
        return np.asarray(orbit.evaluate(theta / orbit.Omega).T / math.sqrt(orbit.S))


@lru_cache(maxsize=4)
def _scaled(family: ModelFamily, values: tuple[tuple[str, float], ...]) -> OdeModel:
    """The equations of q at these parameters, with S as the parameter that is left."""
    S = ca.SX.sym("S")
    equations = family.equations({name: ca.SX(value) for name, value in values}, S)
    model, q = family.model, equations.state
    return OdeModel(
        model.name, q, equations.acceleration, S, 2, ca.SX.sym("v", model.size), reversal=model.reversal,
        half_period=model.half_period, normalisation=ca.dot(q, q) - 1, checked=False,
    )  # fmt: skip
