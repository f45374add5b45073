"""Lattices as data: sites of a cell, bonds between them, boundaries; one or two dimensions; dimensionless."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.chain import declared_chain
from casadi_skin.lattice.declaration import FIXED, Array, Bond, Declaration, Site, Uniform, Value, listed
from casadi_skin.lattice.equations import Equations, forcing_period_of
from casadi_skin.lattice.structure import Structure, structure_of
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.formula import Number
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.statement import named_values

if TYPE_CHECKING:
    from casadi_skin.zero.family import Coordinates, Method

__all__ = ["Bond", "Lattice", "Site", "Uniform"]


class Lattice(OdeModel):
    """A lattice as a model: mass * y'' = -onsite - damping * y' + drive + forces of bonds at every site.

    Without damping and drive the model is of second order, and its reversal, its oddness, its conserved energy and its
    momentum are declared where `structure` shows that they hold. Positions are called y_1, y_2, ..., of several sites
    in a cell y_a_1, y_b_1, ..., in two dimensions y_1_1, y_1_2, ...; velocities v_1, ...

    Arguments:
        cells: cells along each direction, a whole number or one or two of them.
        sites: the sites of one cell.
        bonds: the bonds from the sites of one cell.
        boundary: "fixed" (missing neighbours are held at 0), "free" (their bonds are absent) or "periodic"; one word
            for all directions, or one for each.
        parameters: their values by name: a number, which can be followed; or by cell a list, a formula in n and m, or
            a `Uniform`.
        name: of the model.
        forcing_period: of the drives, a formula in parameters; left out, it is that of the sines and cosines of t in
            them where these have one.

    Raises:
        ValueError, TypeError: the message names the place, the value and the accepted values.
    """

    declaration: Declaration  # type: ignore[misc]
    equations: Equations
    structure: Structure

    def __init__(
        self,
        cells: int | Sequence[int],
        sites: Sequence[Site],
        bonds: Sequence[Bond] = (),
        boundary: str | Sequence[str] = FIXED,
        parameters: Mapping[str, Value] | None = None,
        name: str = "lattice",
        forcing_period: str | None = None,
    ) -> None:
        along = (cells,) if isinstance(cells, int) else listed("cells", cells, int, "a whole number, or one or two")
        walls = (boundary,) * len(along) if isinstance(boundary, str) else listed("boundary", boundary, str, "words")
        if not isinstance(parameters, Mapping | None):
            raise TypeError(f"parameters: given {short_repr(parameters)}; accepted: values by name")
        if not isinstance(name, str):
            raise TypeError(f"name: given {short_repr(name)}; accepted: a string")
        declaration = Declaration(
            along, listed("sites", sites, Site, "a list of sites"), listed("bonds", bonds, Bond, "a list of bonds"),
            walls, dict(parameters or {}),
        )  # fmt: skip
        equations = Equations(declaration)
        object.__setattr__(self, "declaration", declaration)
        object.__setattr__(self, "equations", equations)
        period = forcing_period_of(equations, forcing_period)
        structure = structure_of(equations)
        object.__setattr__(self, "structure", structure)
        common: dict[str, Any] = {
            "name": name, "parameters": equations.parameters, "nominal": equations.nominal, "checked": False,
        }  # fmt: skip
        if equations.autonomous:
            n, momentum = declaration.size, {}
            if structure.momentum and structure.energy is not None:
                momentum = {"momentum": ca.sum1(ca.gradient(structure.energy, equations.v))}
            super().__init__(
                state=equations.y, rhs=equations.accelerations, order=2, velocity=equations.v,
                reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n) if structure.odd else None,
                hamiltonian=structure.energy, conserved=momentum, **common,
            )  # fmt: skip
        else:
            state, rhs = ca.vertcat(equations.y, equations.v), ca.vertcat(equations.v, equations.accelerations)
            time = None if period is None else equations.t
            super().__init__(state=state, rhs=rhs, time=time, forcing_period=period, **common)

    @cached_property
    def with_numbers_apart(self) -> tuple[OdeModel, Mapping[str, Number | None]]:
        """The equations and the energy with every number of the formulas as a parameter, and the numbers by name.

        For proofs of lattices without damping and drive: no arithmetic of numbers is rounded.
        """
        declaration, numbers = self.declaration.with_numbers_apart()
        equations = Equations(declaration)
        energy = structure_of(equations).energy
        return OdeModel(
            self.name, equations.y, equations.accelerations, equations.parameters, 2, equations.v, hamiltonian=energy,
            checked=False,
        ), numbers  # fmt: skip

    def stiffness(self, parameters: Mapping[str, float] | None = None) -> Array:
        """K of y'' = -K y about rest without damping and drives, shape (sites, sites), at values of the parameters."""
        equations, values = self.equations, list(named_values(self, parameters or {}).values())
        derivative = ca.densify(ca.jacobian(equations.accelerations, equations.y))
        function = ca.Function("K", [equations.y, equations.v, equations.t, equations.parameters], [-derivative])
        return np.array(function(0, 0, 0, values))

    def of_cells(self, cells: int | Sequence[int]) -> Lattice:
        """The same lattice of another number of cells, which are alike."""
        d = self.declaration
        values = {
            name: value for name, value in d.parameters.items() if not isinstance(d.by_cell.get(name), np.ndarray)
        }
        return Lattice(cells, d.sites, d.bonds, d.boundary, values, self.name)

    def family_coordinates(
        self, mode: int | str, amplitude_max: float, method: Method, parameters: Mapping[str, float] | None = None
    ) -> Coordinates:
        """Those of the chain where the lattice declares one with such a family; see `follow_family`."""
        values = named_values(self, parameters or {})
        chain = declared_chain(self.declaration, self.equations.autonomous, values)
        if chain is not None:
            try:
                found: Any = chain.family_coordinates(mode, amplitude_max, method)
            except ValueError:
                if method.tail is not None:
                    raise
            else:
                found.declared = self, values
                return found  # type: ignore[no-any-return]
        coordinates: Coordinates = super().family_coordinates(mode, amplitude_max, method, parameters)
        return coordinates

    def __repr__(self) -> str:
        return f"Lattice({self.name}, cells = {list(self.declaration.cells)}, {self.declaration.size} sites)"
