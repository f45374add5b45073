"""What the tables of a chain's scene mean: its chain and its families."""

from __future__ import annotations

from typing import Any

from casadi_skin.lattice.chain import Chain
from casadi_skin.scene import Scene


def scene_chain(scene: Scene) -> Chain:
    """The chain of a scene."""
    table = scene.chain
    sites: Any = table.sites  # a whole number, or inf
    return Chain(sites, table.alpha, table.gamma, table.g)


def scene_requests(scene: Scene) -> list[FamilyRequest]:
    """The families that a scene asks for, in its order; empty where it asks for none.

    Raises ValueError for a tail that cannot be eliminated.
    """
    if scene.family is None:
        return []
    family, method, chain = scene.family, scene.method, scene_chain(scene)
    whole = scene.stability is not None or (scene.export is not None and scene.export.S is not None)
    tail = method.tail or ("full" if whole else None)  # all sites take part in stability, and in what is exported
    return [
        FamilyRequest(
            chain=chain,
            mode=mode,
            amplitude_max=family.amplitude_max,
            at=family.at,
            tolerance=scene.accuracy.relative_tolerance,
            transcription=method.transcription,
            corrector=method.corrector,
            flow=method.flow,
            walker=method.walker,
            degree=method.degree,
            at_Omega=family.at_Omega,
            at_period=family.at_period,
            period_max=family.period_max,
            max_points=family.max_points,
            tail=tail,
        )
        for mode in family.modes(chain.sites)
    ]
