"""The plan of families in words; of the usual families of a chain it is known from the scene, without any numerics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model import methods
from casadi_skin.runs.output import Lines
from casadi_skin.runs.scene import ChainTable, FamilyTable, MethodTable, Scene

KNOWN_TABLES = ("chain", "family", "spectrum", "stability")  # tables whose plan is known from the scene
SMALLEST_SCALED_S, LARGEST_SCALED_S = 1e-100, 1e100  # sizes of g S that are checked no further
TO_MEASURE = "casadi-skin check --measure builds the equations, solves at the start and measures it"
UNKNOWNS = {
    methods.TRIGONOMETRIC: "positions only, as odd cosines",
    methods.SHOOTING: "positions and velocities, integrated by CVODES",
}


class FamilyPlan(NamedTuple):
    """Modes and methods of families as they are chosen for the model, and the words for its symmetry and coordinates.

    `localised` is the number of sites that localised multipliers begin with, where stability is of that kind, and
    `sites` that of a chain whose sites are all unknowns.
    """

    modes: Sequence[int]
    symmetry: str
    coordinates: str
    transcription: str
    flow: str
    localised: int | None = None
    sites: int | None = None


def chain_lines(scene: Scene) -> Lines | None:
    """The plan of a scene of a chain without numerics; None where it is not known without them, or not allowed."""
    chain, family = scene.chain, scene.family
    asked = [name for name in (*KNOWN_TABLES, *_OTHER_TABLES) if getattr(scene, name) is not None]
    if chain is None or family is None or not set(asked) <= set(KNOWN_TABLES) or scene.accuracy.certify:
        return None
    modes = [int(mode) for mode in scene.modes()]
    named = MethodTable(corrector=scene.method.corrector, flow=scene.method.flow)
    usual = scene.method == named and (scene.stability is None or scene.stability.sites is None)
    if not usual or not _has_full_chain(chain, family):
        return None
    if scene.spectrum is not None and chain.alpha + stiffness(chain.sites, chain.gamma, 1) <= 0.0:
        return None
    flow, transcription = scene.methods.flow or "", scene.methods.transcription or ""
    plan = FamilyPlan(modes, methods.QUARTER_PERIOD, methods.EVERY_SITE, transcription, flow, sites=int(chain.sites))
    spectrum = [SPECTRUM_LINE] if scene.spectrum is not None else []
    return [chain_line(int(chain.sites), chain.alpha, chain.gamma, chain.g), *spectrum, *family_lines(scene, plan)]


SPECTRUM_LINE = ("spectrum", "linear frequencies and modes")
_OTHER_TABLES = tuple(
    name
    for name in Scene.__struct_fields__
    if name not in (*KNOWN_TABLES, "title", "figures", "accuracy", "method")  # of which any scene has some
)


def _has_full_chain(chain: ChainTable, family: FamilyTable) -> bool:
    """Whether all sites are unknowns, as `lattice.chain_coordinates` decides, and no limit of doubles is near."""
    ends = [abs(chain.g) * S for S in (family.amplitude_max, *family.at)]
    sizes = (
        min(ends) >= SMALLEST_SCALED_S and max(ends) <= LARGEST_SCALED_S and family.amplitude_max <= LARGEST_SCALED_S
    )
    return chain.sites < methods.PAYS_FROM and abs(chain.gamma) < 1.0 and sizes


def chain_line(sites: float, alpha: float, gamma: float, g: float) -> tuple[str, str]:
    """The chain."""
    return "chain", f"N = {sites}, alpha = {alpha:g}, gamma = {gamma:g}, g = {g:g}"


def family_lines(scene: Scene, plan: FamilyPlan, measured: Lines | None = None) -> Lines:
    """Families, their accuracy, methods and stability.

    Arguments:
        scene: the scene.
        plan: choices for its model.
        measured: lines on the problem, and last one on the cost, where these are measured.
    """
    stability = scene.stability
    lines = [
        ("families", _wanted(scene, plan.modes)),
        ("tolerance", f"{scene.accuracy.relative_tolerance:g}, relative, of Omega and the profile"),
        ("symmetry", plan.symmetry),
        ("coordinates", plan.coordinates),
        ("transcription", f"{plan.transcription}: {UNKNOWNS.get(plan.transcription, 'positions and velocities')}"),
        *(measured[:-1] if measured else _unknowns(plan)),
    ]
    built = f"scaled model, collocation equations, {scene.method.corrector} corrector"
    if stability is not None:
        what = f"multipliers{' and every change of stability' if stability.events else ''}"
        if plan.localised is not None:
            sites = f"{plan.localised} sites at the edge or more"
            what = f"localised multipliers, on {sites}; waves have theirs in closed form"
            if stability.events:
                lines.append(("changes", "of localised multipliers; weak instabilities of waves depend on the length"))
        lines.append(("built", f"{built}, variational system with the {plan.flow} flow for {what}"))
    else:
        lines += [("built", built), ("not built", "the variational system: the scene has no [stability]")]
    if scene.accuracy.certify:
        which = "every orbit" if scene.accuracy.certify == "all" else "the orbits asked for"
        lines.append(("proofs", f"of {which}, in balls"))
    return [*lines, *_of_families(scene), measured[-1] if measured else ("cost", TO_MEASURE)]


def _unknowns(plan: FamilyPlan) -> Lines:
    """The number of unknowns at the start, where it needs no equations."""
    if plan.sites is None or plan.transcription != methods.TRIGONOMETRIC:
        return []
    cosines = methods.FEWEST_COSINES
    words = f"{cosines * plan.sites + 2} at the start ({cosines} odd cosines a site, Omega and S)"
    return [("unknowns", f"{words}; more where the tolerance asks for it")]


def _wanted(scene: Scene, modes: Sequence[int]) -> str:
    """The modes, their ends, and the points that are wanted exactly."""
    family = scene.family
    assert family is not None
    wanted = (("S", family.at), ("Omega", family.at_Omega), ("period", family.at_period))
    exactly = [f"{name} = {', '.join(f'{value:g}' for value in values)}" for name, values in wanted if values]
    at = f", points exactly at {'; '.join(exactly)}" if exactly else ""
    end = f"S = {family.amplitude_max:g}"
    if family.period_max is not None:
        end += f" or a period of {family.period_max:g}, whichever comes first"
    return f"j = {', '.join(map(str, modes))}, to {end}{at}; {family.max_points} points at most"


def _of_families(scene: Scene) -> Lines:
    """Branches and edges followed from families."""
    table, lines = scene.continuation, list[tuple[str, str]]()
    if table is not None and table.switch:
        lines.append(("leaving", f"branches at every {' and '.join(table.switch)}, to S = {table.to:g}"))
    if table is not None and table.curve is not None:
        curve = table.curve
        lines.append(("curves", f"edges of tongues in {curve.parameter} to {curve.to:g}, with S free"))
    return lines
