"""Equations of motion of a declared lattice, in CasADi symbols."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import INDICES, Declaration, Link
from casadi_skin.lattice.expressions import expression


class Equations:
    """The equations of motion of a declared lattice, in CasADi symbols."""

    def __init__(self, declaration: Declaration) -> None:
        self.declaration = declaration
        places = [
            "_".join([*([site.name] if len(declaration.sites) > 1 else []), *(str(k + 1) for k in cell)])
            for cell in declaration.all_cells()
            for site in declaration.sites
        ]
        self.y, self.v = (ca.vertcat(*(ca.SX.sym(f"{x}_{place}") for place in places)) for x in "yv")
        self.t, self._d = ca.SX.sym("t"), ca.SX.sym("d")
        self._y, self._v = ca.vertsplit(self.y), ca.vertsplit(self.v)
        self.parameters = ca.vertcat(*(ca.SX.sym(name) for name in declaration.scalars))
        self.parameters = self.parameters if declaration.scalars else ca.SX(0, 1)
        self.nominal = tuple(declaration.scalars.values())
        self.symbols = dict(zip(declaration.scalars, ca.vertsplit(self.parameters), strict=True))
        self._values: dict[tuple[int, ...], dict[str, ca.SX]] = {}
        self._gains: dict[tuple[int, tuple[int, ...]], tuple[ca.SX, ca.SX]] = {}
        self.links: tuple[Link, ...] = tuple(declaration.links())
        self._check_at_rest()

    # Formulas at a cell -----------------------------------------------------------------------------------------------

    def values(self, cell: tuple[int, ...]) -> dict[str, ca.SX]:
        """What parameters and indices stand for in a cell."""
        if cell not in self._values:
            values = dict(self.symbols) | {name: ca.SX(k + 1) for name, k in zip(INDICES, cell, strict=False)}
            for name, value in self.declaration.by_cell.items():
                values[name] = ca.SX(value[cell]) if isinstance(value, np.ndarray) else expression(value, values)
            self._values[cell] = values
        return self._values[cell]

    def at(self, kind: str, number: int, field: str, cell: tuple[int, ...], **variables: ca.SX) -> ca.SX:
        """A formula of a site or a bond in a cell."""
        return expression(self.declaration.formulas[kind, number, field], self.values(cell) | variables)

    def of_sites(self, field: str) -> list[ca.SX]:
        """A formula of all sites, at their own position, velocity and time."""
        found = []
        for cell in self.declaration.all_cells():
            for s in range(len(self.declaration.sites)):
                i = self.declaration.index(cell, s)
                found.append(self.at("site", s, field, cell, y=self._y[i], v=self._v[i], t=self.t))
        return found

    def extension(self, link: Link) -> ca.SX:
        """d = y_end - y_start, with 0 at a wall."""
        end, start = (ca.SX(0) if i is None else self._y[i] for i in (link.end, link.start))
        return end - start

    def gains(self, link: Link) -> tuple[ca.SX, ca.SX]:
        """The gains at the start and at the end of a bond."""
        if (link.bond, link.cell) not in self._gains:
            first, second = (self.at("bond", link.bond, f"gain {k}", link.cell) for k in (1, 2))
            self._gains[link.bond, link.cell] = first, second
        return self._gains[link.bond, link.cell]

    # The whole lattice ------------------------------------------------------------------------------------------------

    @cached_property
    def masses(self) -> list[ca.SX]:
        """Mass of every site."""
        return self.of_sites("mass")

    @cached_property
    def accelerations(self) -> ca.SX:
        """y'' of every site."""
        onsite, damping, drive = (self.of_sites(field) for field in ("onsite", "damping", "drive"))
        forces = [f - k - c * v for f, k, c, v in zip(drive, onsite, damping, self._v, strict=True)]
        for link in self.links:
            force = self.at("bond", link.bond, "force", link.cell, d=self.extension(link))
            gains = self.gains(link)
            if link.start is not None:
                forces[link.start] += gains[0] * force
            if link.end is not None:
                forces[link.end] -= gains[1] * force
        return ca.vertcat(*(force / mass for force, mass in zip(forces, self.masses, strict=True)))

    @cached_property
    def damped(self) -> bool:
        """Whether velocities enter the forces."""
        return bool(ca.depends_on(self.accelerations, self.v))

    @cached_property
    def driven(self) -> bool:
        """Whether time enters the forces by itself."""
        return bool(ca.depends_on(self.accelerations, self.t))

    @property
    def autonomous(self) -> bool:
        """Whether there is neither damping nor drive."""
        return not (self.damped or self.driven)

    # Checks -----------------------------------------------------------------------------------------------------------

    def at_nominal(self, *results: Any) -> list[Any]:
        """Expressions in parameters as arrays, at the declared values."""
        function = ca.Function("f", [self.parameters], [ca.vertcat(*result) for result in results])
        found = function(self.nominal) if results else []
        found = found if isinstance(found, list | tuple) else [found]
        return [np.array(value).ravel() for value in found]

    def _check_at_rest(self) -> None:
        """Raises ValueError, with the place, for what is not finite at rest, and masses and gains that are none."""
        declaration, cells = self.declaration, list(self.declaration.all_cells())
        for kind, number, field in declaration.formulas:
            variables = dict.fromkeys("yvdt", ca.SX(0))
            found = [self.at(kind, number, field, cell, **variables) for cell in cells]
            (values,) = self.at_nominal(found)
            text, place = declaration.formulas[kind, number, field].text, f"{kind} {number + 1} {field}"
            bad, accepted = ~np.isfinite(values), "a formula that is finite at rest"
            if field == "mass" and not bad.any():
                bad, accepted = values <= 0, "a mass > 0"
            if field.startswith("gain") and not bad.any():
                bad, accepted = values == 0, "gains that are not 0, so that a bond acts both ways"
            if bad.any():
                k = int(np.argmax(bad))
                where = ", ".join(str(i + 1) for i in cells[k])
                raise ValueError(
                    f'{place}: given "{text}", which is {values[k]:g} in cell {where}; accepted: {accepted}'
                )
