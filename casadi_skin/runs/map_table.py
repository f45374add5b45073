"""The table [map]: parameters of the scene that vary, and how their cells are computed.

Names that are no option are axes: a parameter of the scene with a range or a list of values.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from casadi_skin.runs.scene_tables import Finite, Positive, Table

_MAX_POINTS = 100_000
_Text = Annotated[str, Meta(min_length=1)]
_Points = Annotated[int, Meta(ge=2, le=_MAX_POINTS)]
_NAMES = "a list of names of quantities"


class RangeTable(Table, frozen=True):
    """An axis of a map: values from one number to another, evenly or in equal ratios."""

    start: Annotated[int | Finite, Meta(title="First value", description="a finite number")] = msgspec.field(
        name="from"
    )
    to: Annotated[int | Finite, Meta(title="Last value", description="a finite number, not the first one")]
    points: Annotated[_Points, Meta(title="Number of values", description=f"a whole number >= 2 and <= {_MAX_POINTS}")]
    log: Annotated[bool, Meta(title="Equal ratios in place of equal differences", description="true or false")] = False
    resolution: Annotated[
        Positive | None,
        Meta(
            title="Largest difference (ratio, with log) of neighbours where a watched quantity changes",
            description="a finite number > 0, with log > 1 (left out: nothing is refined along this axis)",
        ),
    ] = None


_Value = int | Finite | _Text
_Together = Annotated[tuple[_Value, ...], Meta(min_length=2)]  # a value for each of several parameters
AxisTable = RangeTable | Annotated[tuple[_Value | _Together, ...], Meta(min_length=1)]


class MapTable(Table, frozen=True):
    """A map of the scene over its parameters; every key that is none of these is an axis, named by its parameter."""

    axes: Annotated[
        dict[str, AxisTable],
        Meta(
            title="Axes by parameter; each may stand in [map] itself",
            description="tables { from, to, points, log, resolution }, or lists of values; beside names with commas "
            'between them lists of lists, such as "g, mode" = [[-1.0, "first"], [1.0, "last"]]',
        ),
    ] = msgspec.field(default_factory=dict)
    quantities: Annotated[
        Annotated[tuple[_Text, ...], Meta(min_length=1)] | None,
        Meta(title="Quantities kept and drawn", description=f"{_NAMES} (left out: all that the scene has)"),
    ] = None
    watch: Annotated[
        Annotated[tuple[_Text, ...], Meta(min_length=1)] | dict[str, tuple[Finite, ...]] | None,
        Meta(
            title="Quantities where whose changes cells are refined",
            description=f"{_NAMES}, or a table of lists of levels by name (left out: stable and end)",
        ),
    ] = None
    boundary: Annotated[
        bool, Meta(title="The boundary of stability is followed and drawn over the map", description="true or false")
    ] = False
    growth: Annotated[
        Annotated[float, Meta(ge=0, le=1e300)],
        Meta(
            title="Growth over a period, log |multiplier|, from which on an instability is the first one",
            description="a finite number >= 0",
        ),
    ] = 0.0
    cell_limit: Annotated[
        Positive | None,
        Meta(title="Seconds that a cell may take", description="a finite number > 0 (left out: no limit)"),
    ] = None


OPTIONS: tuple[str, ...] = MapTable.__struct_encode_fields__
