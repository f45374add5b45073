"""The request of a scene, with its model at hand: everything is checked before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import asdict, astuple

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.rules import check_known, faults_at, refusal
from casadi_skin.runs.scene import CONSERVED, LatticeTable, OrbitTable, Scene, UniformTable
from casadi_skin.zero.family import Method, Targets
from casadi_skin.zero.problem import Array
from casadi_skin.zero.request import FamilyRequest

if TYPE_CHECKING:
    from casadi_skin.lattice.lattice import Lattice
    from casadi_skin.lattice.long_lattice import LongLattice
    from casadi_skin.zero.guesses import Guess
    from casadi_skin.zero.statement import BoundaryValueProblem


# Values and states as a scene gives them, by name or in order ---------------------------------------------------------

Numbers = Sequence[float] | Mapping[str, float]


def values_of(model: OdeModel, given: Mapping[str, float]) -> dict[str, float]:
    """Values of all parameters of a model by name; raises SceneError."""
    for name in given:
        check_known("[model] parameters", name, model.parameter_names)
    if model.order == 2 and model.normalisation is not None:  # the amplitude's parameter needs no value
        return dict(given)
    from casadi_skin.zero.statement import named_values

    with faults_at("[model] "):
        return named_values(model, given)


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

    @property
    def orbit(self) -> OrbitTable:
        """The table [orbit]; raises ValueError where there is none."""
        if self.scene.orbit is None:
            raise ValueError("[orbit]: missing; accepted: a scene with an [orbit]")
        return self.scene.orbit

    @cached_property
    def families(self) -> tuple[FamilyRequest, ...]:
        """The families of the scene, in its order; raises ValueError for families that cannot be followed."""
        family = self.scene.family
        if family is None:
            return ()
        targets = Targets(family.at, family.at_Omega, family.at_period, family.period_max, family.max_points)
        export = self.scene.export
        exported, stability = export is not None and export.S is not None, self.scene.stability is not None
        found = []
        for mode in self.scene.modes():
            request = FamilyRequest(
                self.model, mode, family.amplitude_max, targets, self.tolerance, method_of(self.scene),
                self.model_parameters, self.scene.accuracy.certify, decimals=bool(self.scene.accuracy.certify),
            )  # fmt: skip
            if exported:
                request.coordinates.check_whole("[export] S")
            found.append(request.for_stability(self.scene.method.walker) if exported or stability else request)
        return tuple(found)

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


def method_of(scene: Scene) -> Method:
    """The table [method] in the form for families."""
    sites = None if scene.stability is None else scene.stability.sites
    return Method(**asdict(scene.method), stability_sites=sites)


def lattice_of(table: LatticeTable) -> Lattice | LongLattice:
    """The lattice of a scene, with a linear tail where the table has one.

    Raises ValueError and TypeError, with the place in the table.
    """
    from casadi_skin.lattice.lattice import Bond, Lattice, Site, Uniform

    sites = [Site(*map(str, astuple(site))) for site in table.site]
    bonds = []
    for bond in table.bond:
        offset = (bond.offset,) if isinstance(bond.offset, int) else bond.offset
        bonds.append(Bond(bond.start, bond.end, offset, str(bond.force), (str(bond.gain[0]), str(bond.gain[1]))))
    values: dict[str, Any] = {
        name: Uniform(**asdict(value)) if isinstance(value, UniformTable) else value
        for name, value in table.parameters.items()
    }
    if not table.long:
        cells: Any = table.cells  # finite: inf is long
        return Lattice(cells, sites, bonds, table.boundary, values, forcing_period=table.forcing_period)
    from casadi_skin.lattice.long_lattice import LongLattice

    cells = table.cells[0] if isinstance(table.cells, tuple) and len(table.cells) == 1 else table.cells
    boundary: Any = table.boundary[0] if isinstance(table.boundary, tuple) else table.boundary
    return LongLattice(cells, sites, bonds, boundary, values, table.edge)
