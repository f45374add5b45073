"""Checks of the scene of a chain, as far as they need no numerics."""

import math

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.runs.faults import refusal
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.scene_tables import ChainTable, FamilyTable

NEAREST = 1e-12  # relative, of the end of a family to its start
NARROWEST_BAND = 1e-10  # the same as in lattice.chain_coordinates, which loads numerics


def check_chain_family(scene: Scene, chain: ChainTable, family: FamilyTable) -> None:
    """Raises SceneError for families that the chain does not have."""
    if chain.g == 0:
        reason = "the family would be the linear mode at every amplitude"
        raise refusal("[chain] g", repr(chain.g), f"with a [family] a finite number other than 0 ({reason})")
    if abs(chain.gamma) == 1 and scene.stability is not None and scene.stability.vectors:
        reason = "the vectors form Jordan chains that the gauge does not have"
        raise refusal("[stability] vectors", f"true with gamma = {chain.gamma!r}", f"false ({reason})")
    for mode in family.modes(chain.sites):
        _check_gauge(chain, mode)
        _check_frequency(chain, mode)
        _check_period(chain, family, mode)


def check_infinite(scene: Scene) -> None:
    """Refuse requests that need every site of an infinite chain."""
    for name in ("spectrum", "dynamics", "orbit"):
        if getattr(scene, name) is not None:
            raise refusal(f"[{name}]", "with sites = inf", "with a whole number of sites: all of them take part in it")
    if scene.stability is not None and scene.stability.vectors:
        raise refusal("[stability] vectors", "true with sites = inf", "false: all sites take part in them")


def check_long_lattice(scene: Scene) -> None:
    """Refuse requests that need every site of a lattice with a linear tail."""
    names = ("spectrum", "dynamics", "orbit", "equilibrium", "continuation", "search", "export")
    for name in names:
        if getattr(scene, name) is not None:
            raise refusal(f"[{name}]", "with a linear tail (edge, or more than 100000 cells)", "with all sites unknown")
    if scene.stability is not None and scene.stability.vectors:
        raise refusal("[stability] vectors", "true with a linear tail", "false: all sites take part in them")


def _check_gauge(chain: ChainTable, mode: int) -> None:
    """Refuse the modes that have no family at |gamma| = 1, where every coupling acts one way only."""
    only = chain.sites if chain.g > 0 else 1
    if abs(chain.gamma) == 1 and mode != only:
        reason = (
            "at |gamma| = 1 all frequencies meet and only mode N (g > 0) or mode 1 (g < 0), "
            "in which the edge site alone moves, can be followed"
        )
        raise refusal("[family] mode", f"mode {mode} with gamma = {chain.gamma!r}", f"mode {only} ({reason})")


def _check_frequency(chain: ChainTable, mode: int) -> None:
    """Refuse a mode that does not oscillate: omega_j^2 = 2 + alpha - 2 s cos(j pi/(N+1)) <= 0."""
    own = stiffness(chain.sites, chain.gamma, mode)
    if chain.alpha + own <= 0:
        given = f"mode {mode}, which has omega^2 = {chain.alpha + own:.6g} at alpha = {chain.alpha!r}"
        accepted = f"modes with omega^2 > 0; for mode {mode}: alpha > {-own:.12g}"
        raise refusal("[family] mode", given, accepted)
    s = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
    if chain.sites > 1 and 0 < 4 * s < NARROWEST_BAND * (chain.alpha + own):
        reason = "beside a larger one the modes of the band are the same in doubles"
        accepted = f"with a [family] up to {4 * s / NARROWEST_BAND:.3g} ({reason})"
        raise refusal("[chain] alpha", repr(chain.alpha), accepted)


def _check_period(chain: ChainTable, family: FamilyTable, mode: int) -> None:
    """Refuse an end at a period that the linear mode, where the family starts, has or exceeds."""
    if family.period_max is None:
        return
    linear = 2 * math.pi / math.sqrt(chain.alpha + stiffness(chain.sites, chain.gamma, mode))
    if family.period_max <= linear * (1 + NEAREST):
        accepted = f"a finite number > {linear:.12g} (the period of linear mode {mode})"
        raise refusal("[family] period_max", repr(family.period_max), accepted)
