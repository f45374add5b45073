"""Branches and edges that a run follows from families."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from casadi_skin.follow.branch import Branch

if TYPE_CHECKING:
    from casadi_skin.points.edges import EdgeCurve


@dataclass
class Offshoots:
    """Branches and edges followed from families; the lists fill as a run goes on.

    Attributes:
        leaving: branches that leave families, with their names.
        edges: edges of tongues with the number of the mode, the table that they are in, and their places there from 1.
    """

    leaving: list[tuple[str, Branch]] = field(default_factory=list)
    edges: list[tuple[int, str, int, EdgeCurve]] = field(default_factory=list)
