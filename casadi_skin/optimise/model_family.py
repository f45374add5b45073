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

from casadi_skin.arguments import short_repr
from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.bvp.statement import named_values
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.continuation.arclength import ArclengthContinuation
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import ContinuationSettings, Point, Target
from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.observables import QUANTITIES, RESERVED, FamilyEquations, FreeNumber, Member, Observables
from casadi_skin.solvers.levels import Levels
from casadi_skin.solvers.newton import NewtonCorrector

SMALL = 1e-4  # of the S wanted: where the linear mode is corrected, and the family is followed from
HARMONICS = (4, 6, 8, 10, 12, 16, 24, 32, 48, 64, 96, 128)


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
        energy = () if model.hamiltonian is None else ("energy", "energy_slope")
        reserved = {*QUANTITIES, *RESERVED} - {"energy", "energy_slope"} | set(energy)
        for name in (*model.parameter_names, *model.outputs):
            if name in reserved:
                raise ValueError(f"{model.name}: given a parameter or output called {name}; accepted: other names")
        number = {None: 1, "first": 1, "last": model.size}.get(mode, mode) if isinstance(mode, str | None) else mode
        if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= model.size:
            raise ValueError(f"mode: given {short_repr(mode)}; accepted: 1 to {model.size}, first, last")
        family = cls(model, number, named_values(model, parameters))
        family._linear_mode({})  # raises where it does not oscillate
        return family

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

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        return np.full(self.size, math.sqrt(S))

    def plain(self, values: Mapping[str, Any], S: float) -> tuple[OdeModel, float]:
        return _scaled(self, tuple(sorted(values.items()))), S

    def _linear_mode(self, values: Mapping[str, Any]) -> tuple[Array, float]:
        """The mode at unit length with its frequency; raises ValueError where it does not oscillate."""
        model, p = self.model, [float(values.get(name, value)) for name, value in self.values.items()]
        stiffness = -np.array(ca.DM(model.rhs_and_jacobian()(np.zeros(model.size), p)[1]))
        squares, modes = np.linalg.eig(stiffness)
        order = np.argsort(squares.real)
        square = complex(squares[order[self.mode - 1]])
        if not (square.real > 0 and abs(square.imag) < 1e-9 * square.real):
            raise ValueError(f"mode: given {self.mode}, whose linear frequency squared is {square:.6g}; accepted: > 0")
        mode = modes[:, order[self.mode - 1]].real
        mode *= np.sign(mode[np.argmax(np.abs(mode))]) / np.linalg.norm(mode)
        return np.asarray(mode), math.sqrt(square.real)

    def members(self, values: Mapping[str, Any], amplitudes: Sequence[float], tolerance: float) -> list[Member]:
        mode, Omega = self._linear_mode(values)
        model, wanted = self.plain(values, 0.0)[0], sorted(set(amplitudes))
        levels = Levels(lambda H: TrigonometricProblem(model, H), lambda p: NewtonCorrector(p), HARMONICS)
        at = tuple(Target(Scalar.PARAMETER, S) for S in wanted)
        solver = PointSolver(levels, ContinuationSettings(wanted[-1], tolerance, at, tiny_first=False))
        problem, first = levels.problem(HARMONICS[0]), SMALL * wanted[0]
        assert isinstance(problem, TrigonometricProblem)
        row = problem.parameter_row()
        correction = levels.corrector(problem).correct(problem.pack(mode, Omega, first), row, first)
        start = solver.refined(problem, correction, row, Scalar.PARAMETER) if correction.converged else None
        if start is None:
            raise ArithmeticError(f"{self.model.name}: no orbit near the linear mode; {correction.message}")
        walk, found = ArclengthContinuation(solver, (start,)), dict[float, Point]()
        for point in walk:
            found.setdefault(point.parameter, point)
        missing = [S for S in wanted if S not in found]
        if missing:
            raise ArithmeticError(f"{self.model.name}: the family has no orbit at S = {missing[0]:.6g}; {walk.detail}")
        return [Member.of(found[S]) for S in amplitudes]


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
