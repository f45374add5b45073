"""Tables of a scene of a lattice that is declared in it: cells, sites and bonds, boundaries, values of parameters.

As in the other tables, titles say what a key is and descriptions what it accepts. The model is dimensionless.
"""

import sys
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from casadi_skin.runs.scene_tables import Finite, Table

_Text = Annotated[str, Meta(min_length=1)]
_Formula = _Text | Finite
_Count = Annotated[int, Meta(ge=1, le=100_000)]
_Along = Annotated[int, Meta(ge=1, le=1_000_000_000_000)] | Annotated[float, Meta(gt=sys.float_info.max)]  # or inf
MOST_CELLS = 100_000  # whose sites may all be unknown; the same as in lattice.declaration, which loads numerics
_Step = Annotated[int, Meta(ge=-100_000, le=100_000)]
_Boundary = Literal["fixed", "free", "periodic"]
_FORMULA = "a number, or a formula in quotes: numbers, parameters, n and m, + - * / ^ and elementary functions"


class UniformTable(Table, frozen=True):
    """Values by cell that are drawn evenly, with a seed."""

    low: Annotated[Finite, Meta(title="Lowest value", description="a finite number")]
    high: Annotated[Finite, Meta(title="Highest value", description="a finite number")]
    seed: Annotated[Annotated[int, Meta(ge=0)], Meta(title="Seed", description="a whole number >= 0")]


class SiteTable(Table, frozen=True):
    """A site of each cell: mass * y'' = -onsite - damping * y' + drive + forces of bonds."""

    name: Annotated[_Text, Meta(title="What bonds call the site", description="a name")]
    onsite: Annotated[_Formula, Meta(title="Restoring force", description=f"{_FORMULA}; in y too")] = "0"
    mass: Annotated[_Formula, Meta(title="Mass", description=_FORMULA)] = "1"
    damping: Annotated[_Formula, Meta(title="Factor of -y' in the force", description=f"{_FORMULA}; in y, v too")] = "0"
    drive: Annotated[
        _Formula, Meta(title="Force in time", description=f"{_FORMULA}; in t too, periodic, such as cos(omega*t)")
    ] = "0"


class BondTable(Table, frozen=True):
    """A bond of each cell, with a force F(d) of its extension d = y_to - y_from."""

    start: Annotated[_Text, Meta(title="Site that the bond starts from", description="the name of a site")] = (
        msgspec.field(name="from")
    )
    end: Annotated[_Text, Meta(title="Site that the bond leads to", description="the name of a site")] = msgspec.field(
        name="to"
    )
    offset: Annotated[
        _Step | tuple[_Step, ...],
        Meta(title="Cells from the one to the other", description="a list of whole numbers, one along each direction"),
    ]
    force: Annotated[_Formula, Meta(title="Force F(d)", description=f"{_FORMULA}; in d too")] = "d"
    gain: Annotated[
        tuple[_Formula, _Formula],
        Meta(
            title="The force on `from` is gain[0] * F(d), on `to` it is -gain[1] * F(d)",
            description=f"two of these: {_FORMULA}",
        ),
    ] = ("1", "1")


class LatticeTable(Table, frozen=True):
    """A lattice: cells along one or two directions, their sites and bonds; formulas are data and are never run."""

    cells: Annotated[
        _Along | Annotated[tuple[_Count, ...], Meta(min_length=1, max_length=2)],
        Meta(title="Cells along each direction", description="a whole number >= 1, inf, or a list of one or two"),
    ]
    site: Annotated[
        Annotated[tuple[SiteTable, ...], Meta(min_length=1)],
        Meta(title="Sites of a cell", description="one table [[lattice.site]] or more, with name"),
    ]
    bond: Annotated[
        tuple[BondTable, ...],
        Meta(title="Bonds of a cell", description="tables [[lattice.bond]] with from, to and offset"),
    ] = ()
    boundary: Annotated[
        _Boundary | tuple[_Boundary, ...],
        Meta(
            title="What is beyond the ends: neighbours at 0, none, or the other end",
            description='"fixed", "free", "periodic", or a list of one a direction',
        ),
    ] = "fixed"
    parameters: Annotated[
        dict[str, Finite | _Text | tuple[Finite | tuple[Finite, ...], ...] | UniformTable],
        Meta(
            title="Values of parameters by name",
            description="a table of finite numbers; by cell lists, formulas in n and m, or { low, high, seed }",
        ),
    ] = msgspec.field(default_factory=dict)
    edge: Annotated[
        Literal["first", "last"] | None,
        Meta(
            title="Edge whose breathers are followed, the tail behind it linear",
            description='"first" or "last" (left out: all sites; of more than 100000 cells the end that they lean to)',
        ),
    ] = None
    forcing_period: Annotated[
        _Text | None,
        Meta(
            title="Period of the drives",
            description="a formula in parameters (left out: that of the sines and cosines of t)",
        ),
    ] = None

    @property
    def long(self) -> bool:
        """Whether all but the cells at one edge are a linear tail."""
        return self.edge is not None or (not isinstance(self.cells, tuple) and self.cells > MOST_CELLS)
