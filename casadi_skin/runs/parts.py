"""What the parts of a run share: pictures, what made a result, the mode of a family, whether a branch ended well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casadi_skin.follow.branch import Branch
from casadi_skin.results.dataset import versions
from casadi_skin.results.figures.style import save
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.zero.settings import End

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from casadi_skin.points.edges import EdgeCurve


def picture(scene: Scene, stem: Path, draw: Callable[..., Figure | None], *shown: Any, **options: Any) -> None:
    """Draw a figure and write it as `stem`.png and so on; a scene without formats draws nothing."""
    if scene.figures.formats:
        figure = draw(*shown, **options)
        if figure is not None:
            save(figure, stem, scene.figures.formats)


def origin(request: Request, scene_text: str, branch: Branch | None = None) -> dict[str, float | str]:
    """The request, its model, and the versions that computed it."""
    known: dict[str, float | str] = {"title": request.scene.title or "", "scene": scene_text, **versions()}
    if branch is not None and branch.space.is_family and request.scene.chain is not None:
        return {**known, **branch.space.coordinates.attributes}
    if request.scene.chain is not None:
        chain = request.scene.chain
        return {**known, "sites": chain.sites, "alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g}
    file = request.scene.model.file if request.scene.model is not None else ""
    name = request.model.name  # of a model; a chain has none
    return {**known, "model": name, "model_file": file, "model_source": request.source}


def mode_of(branch: Branch) -> int:
    """Number of the linear mode of a family."""
    return int(branch.space.coordinates.mode_number)


NATURAL = (  # ends of branches that leave another one, or are followed in two parameters
    End.HOPF, End.REJOINED, End.UNBOUNDED, End.BOUND, End.TAKENS, End.CLOSED, End.RETURNED, End.AWAY, End.BAUTIN,
    End.HOPF_HOPF, End.ZERO_HOPF, End.RESONANCE_ONE, End.RESONANCE_TWO,
)  # fmt: skip


def ended_well(branch: Branch) -> bool:
    """Whether a branch reached its requested end, or its natural end where it left another one."""
    further = getattr(branch.space, "leaves", False) or branch.space.kind  # it left another one, or is a curve
    return branch.complete or bool(further and branch.end in NATURAL and not any(branch.misses.values()))


@dataclass
class Offshoots:
    """Branches and edges followed from families; the lists fill as a run goes on.

    Attributes:
        leaving: branches that leave families, with their names.
        edges: edges of tongues with the number of the mode, the table that they are in, and their places there from 1.
    """

    leaving: list[tuple[str, Branch]] = field(default_factory=list)
    edges: list[tuple[int, str, int, EdgeCurve]] = field(default_factory=list)
