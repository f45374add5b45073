"""The request of a scene, with its model at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import asdict

from casadi_skin.model.arguments import check_name, state_by_name
from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.rules import faults_at, refusal
from casadi_skin.runs.scene import CONSERVED, Scene
from casadi_skin.zero.family import FamilyRequest, Method, Targets
from casadi_skin.zero.kinds import EQUILIBRIUM_CURVES, ORBIT_CURVES
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from casadi_skin.search.design_problem import DesignProblem
    from casadi_skin.zero.orbit import Guess
    from casadi_skin.zero.statement import BoundaryValueProblem

Numbers = Sequence[float] | Mapping[str, float]  # states in order, or by name


def state_of(given: Numbers, names: Sequence[str], place: str = "start") -> Array:
    """A state from a list, or from a table by the names of states; raises SceneError where it does not fit these."""
    if not isinstance(given, Mapping) and len(given) != len(names):
        raise refusal(place, f"a list of {len(given)}", f"{len(names)} numbers: {', '.join(names)}")
    with faults_at(""):
        return np.array(state_by_name(place, given, names) if isinstance(given, Mapping) else given, dtype=float)


@dataclass(frozen=True, eq=False)
class Request:
    """A scene with its model: a chain, a lattice, a model of one's own, or a boundary-value problem of it.

    Attributes:
        scene: the scene.
        model: the `Chain`, the `LongLattice` or the `OdeModel` as declared.
        parameters: values of all parameters of a model by name.
        path: the file of the model; None for a chain and a lattice.
        source: its text.
        problem: the boundary-value problem, where the file states one.
        guess: guess of its solution.
    """

    scene: Scene
    model: Any
    parameters: Mapping[str, float]
    path: Path | None = None
    source: str = ""
    problem: BoundaryValueProblem | None = None
    guess: Guess | None = None

    @property
    def tolerance(self) -> float:
        """The relative error allowed."""
        return self.scene.accuracy.relative_tolerance

    @property
    def model_parameters(self) -> Mapping[str, float] | None:
        """Values of parameters of an `OdeModel`; None of a chain and of a lattice with a tail, which have their own."""
        long = self.scene.lattice is not None and self.scene.lattice.long
        return None if long or self.scene.chain is not None else self.parameters

    @cached_property
    def equations(self) -> OdeModel:
        """The equations of motion in the coordinates of the model; always the same symbols."""
        if self.scene.lattice is not None and self.scene.lattice.long:
            raise ValueError("[lattice]: given one with a linear tail, whose equations are not written down")
        model: OdeModel = self.model if self.scene.chain is None else self.model.tunable_model()
        return model

    @cached_property
    def ode(self) -> OdeModel:
        """The equations of motion of first order, in the same symbols."""
        return self.equations.first_order()

    @cached_property
    def families(self) -> tuple[FamilyRequest, ...]:
        """The families of the scene, in its order; raises ValueError for families that cannot be followed."""
        scene, family = self.scene, self.scene.family
        if family is None:
            return ()
        targets = Targets(family.at, family.at_Omega, family.at_period, family.period_max, family.max_points)
        sites = None if scene.stability is None else scene.stability.sites
        method, certify = Method(**asdict(scene.method), stability_sites=sites), scene.accuracy.certify
        exported, found = scene.export is not None and scene.export.S is not None, []
        for mode in scene.modes():
            request = FamilyRequest(
                self.model, mode, family.amplitude_max, targets, self.tolerance, method, self.model_parameters, certify,
                decimals=bool(certify),
            )  # fmt: skip
            if exported:
                request.coordinates.check_whole("[export] S")
            whole = exported or scene.stability is not None
            found.append(request.for_stability(scene.method.walker) if whole else request)
        return tuple(found)

    def designed(self, points: Sequence[Any] = ()) -> DesignProblem:
        """What [design] asks for, of these special points, or of orbits of a family that are not computed yet.

        Raises ValueError and TypeError for values that are not accepted.
        """
        from casadi_skin.search.design_problem import DesignProblem, family_starts

        table: Any = self.scene.design
        amplitudes = table.S if isinstance(table.S, tuple) else (table.S or 1.0,)
        of = points or family_starts(self.model, table.mode, amplitudes, self.model_parameters, self.tolerance)
        bounds = {name: [*ends] for name, ends in table.bounds.items()}
        return DesignProblem.of(table.quantity, list(of), table.over, self._held, bounds, table.maximise)

    @property
    def _held(self) -> list[tuple[Any, ...]]:
        """Constraints of [design], each a quantity with its bounds."""
        return [
            (held.quantity, *((held.equal, held.equal) if held.equal is not None else (held.lower, held.upper)))
            for held in self.scene.design.subject_to  # type: ignore[union-attr]
        ]

    def check_design(self) -> None:
        """Check [design] before its special points are located; raises ValueError and TypeError as `designed` does."""
        from casadi_skin.search.conditions import checked_bounds, checked_conditions, free_names

        table: Any = self.scene.design
        if not table.of:
            self.designed()
            return
        for kind, number in map(kind_and_number, table.of):
            check_name("of", kind, dict.fromkeys((*EQUILIBRIUM_CURVES, *ORBIT_CURVES)))
            if number < 1:
                raise ValueError(f"of: given '{kind} {number}'; accepted: a kind with its number from 1")
        parameter: Any = self.scene.continuation.parameter  # type: ignore[union-attr]
        names = [name for name in self.equations.parameter_names if name != parameter]
        over = free_names(table.over, names, "over")
        held = [name for name in names if name not in over]
        checked_bounds(table.bounds, dict.fromkeys(over, (-np.inf, np.inf)), held, [parameter])
        checked_conditions(self._held, (), "", "subject_to")

    @property
    def options(self) -> dict[str, Any]:
        """Options of [accuracy] and [method] for the solver of a boundary-value problem."""
        names = ("transcription", "degree", "intervals", "flow", "corrector")
        given = {name: value for name in names if (value := getattr(self.scene.method, name)) is not None}
        return {"tolerance": self.tolerance, **given}

    def quantity(self, name: str) -> Expression:
        """A state, an output, or what is conserved, by name."""
        model = self.ode
        states = {state: model.state[i] for i, state in enumerate(model.state_names)}
        return {**model.outputs, **model.conserved, CONSERVED: model.hamiltonian, **states}[name]

    def condition(self, given: Mapping[str, float] | None) -> Expression | None:
        """What vanishes where a quantity has its value, from a table with one number by its name."""
        return next((self.quantity(name) - value for name, value in (given or {}).items()), None)


def kind_and_number(name: str) -> tuple[str, int]:
    """The kind of a special point and its number among those of the kind, from 1: "fold 2", or "fold" for the first."""
    kind, _, last = name.rpartition(" ")
    return (kind, int(last)) if last.isdecimal() else (name, 1)
