"""What made a result: the request, its model, the versions; and the mode of a family."""

from __future__ import annotations

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel
from casadi_skin.results.dataset import versions
from casadi_skin.runs.request import Request


def origin(request: Request, scene_text: str, branch: Branch | None = None) -> dict[str, float | str]:
    """The request, its model, and the versions that computed it."""
    known: dict[str, float | str] = {"title": request.scene.title or "", "scene": scene_text, **versions()}
    if branch is not None and isinstance(branch.space, Family) and request.scene.chain is not None:
        return {**known, **branch.space.coordinates.attributes}
    if request.scene.chain is not None:
        chain = request.scene.chain
        return {**known, "sites": chain.sites, "alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g}
    file = request.scene.model.file if request.scene.model is not None else ""
    name = request.ode.name if isinstance(request.model, Chain | OdeModel) else request.model.name
    return {**known, "model": name, "model_file": file, "model_source": request.source}


def mode_of(branch: Branch) -> int:
    """Number of the linear mode of a family."""
    assert isinstance(branch.space, Family)
    return branch.space.coordinates.mode_number
