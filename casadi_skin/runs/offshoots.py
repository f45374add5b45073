"""Branches and edges that a run follows from families, and whether a branch ended well."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from casadi_skin.follow.branch import Branch
from casadi_skin.zero.settings import End

if TYPE_CHECKING:
    from casadi_skin.points.edge_curve import EdgeCurve

NATURAL = (
    End.HOPF,
    End.REJOINED,
    End.UNBOUNDED,
    End.BOUND,
    End.TAKENS,
    End.CLOSED,
    End.RETURNED,
    End.AWAY,
    End.BAUTIN,
    End.HOPF_HOPF,
    End.ZERO_HOPF,
    End.RESONANCE_ONE,
    End.RESONANCE_TWO,
)  # ends of branches that leave another one, or are followed in two parameters


def is_further(branch: Branch) -> bool:
    """Whether a branch left another one, or is a curve in two parameters."""
    return bool(getattr(branch.space, "leaves", False) or branch.space.kind)


def ended_well(branch: Branch) -> bool:
    """Whether a branch reached its requested end, or its natural end where it left another one."""
    return branch.complete or (is_further(branch) and branch.end in NATURAL and not any(branch.misses.values()))


@dataclass
class Offshoots:
    """Branches and edges followed from families; the lists fill as a run goes on.

    Attributes:
        leaving: branches that leave families, with their names.
        edges: edges of tongues with the number of the mode, the table that they are in, and their places there from 1.
    """

    leaving: list[tuple[str, Branch]] = field(default_factory=list)
    edges: list[tuple[int, str, int, EdgeCurve]] = field(default_factory=list)
