"""Checks that tie the keys of [dynamics], [export], [figures] and [search] to other tables."""

import math

from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.runs.faults import SceneError, check_known, refusal, toml_repr
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.scene_tables import ChainTable, FamilyTable
from casadi_skin.runs.task_tables import DynamicsTable

LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics


def check_dynamics(scene: Scene) -> None:
    dynamics = scene.dynamics
    if dynamics is None:
        return
    alone = scene.family is None and scene.orbit is None
    if alone:
        _check_start(scene, dynamics)
    elif dynamics.moving:
        raise refusal("[dynamics] moving", "true", "without [family] and [orbit], which start at phase zero")
    elif scene.family is None:
        for name in ("S", "mode"):
            if getattr(dynamics, name) is not None:
                raise refusal(f"[dynamics] {name}", repr(getattr(dynamics, name)), "beside a [family]")
    elif dynamics.S is None:
        raise SceneError("[dynamics] S: missing; accepted: a finite number > 0, up to amplitude_max")
    else:
        _check_orbit_of_family("dynamics", scene, scene.family, dynamics.S, dynamics.mode)
    if (dynamics.duration is None) == (dynamics.periods is None):
        given = "neither duration nor periods" if dynamics.duration is None else "duration and periods"
        raise refusal("[dynamics]", given, "duration or periods, one of them")
    _check_kinds(dynamics, alone)
    if scene.chain is not None:
        _check_envelope(scene.chain)
        _check_perturbation(scene.chain, dynamics)


def check_figures(scene: Scene) -> None:
    formats = scene.figures.formats
    for item, name in enumerate(formats, start=1):
        if name in formats[: item - 1]:
            raise refusal("[figures] formats", f"{toml_repr(name)} as item {item} again", "each format once")


def _check_orbit_of_family(table: str, scene: Scene, family: FamilyTable, S: float, mode: int | None) -> None:
    """An orbit at S of the family of a mode, which has to be named where there are several.

    Whether a model has a mode by the number of one that is named, as "last", shows with the model alone.
    """
    followed = scene.modes()
    modes = f"one of the modes of [family], {toml_repr(list(followed))}"
    if mode is None and len(followed) > 1:
        raise SceneError(f"[{table}] mode: missing; accepted: {modes}")
    named = any(isinstance(known, str) for known in followed)
    if mode is not None and mode not in followed and not named:
        raise refusal(f"[{table}] mode", toml_repr(mode), modes)
    if family.amplitude_max < S:
        raise refusal(f"[{table}] S", repr(S), f"a number <= amplitude_max = {family.amplitude_max!r}")


def _check_envelope(chain: ChainTable) -> None:
    """Refuse chains whose displacements at the far end are below the smallest double."""
    if abs(chain.gamma) < 1 and (chain.sites - 1) * math.atanh(abs(chain.gamma)) > LONGEST_ENVELOPE:
        given = f"with sites = {chain.sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"
        raise refusal("[dynamics]", given, f"(sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}")


def _check_start(scene: Scene, dynamics: DynamicsTable) -> None:
    """Requirements of a motion from near rest."""
    for name in ("equilibrium", "solution", "search"):
        if getattr(scene, name) is not None:
            raise refusal("[dynamics]", f"beside [{name}]", "beside [family] or [orbit], or with a start of its own")
    kinds = ("mode", "site", "vector", "seed")
    given = [name for name in kinds if getattr(dynamics, name) is not None]
    if len(given) != 1:
        words = f"without [family] and [orbit], with {' and '.join(given) or 'none of ' + ', '.join(kinds)}"
        raise refusal(
            "[dynamics]", words, f"one of {', '.join(kinds)}, with size and duration, from which motion starts"
        )
    for name in ("S", "periods"):
        if getattr(dynamics, name) is not None:
            raise refusal(f"[dynamics] {name}", repr(getattr(dynamics, name)), "beside a [family] or an [orbit]")
    for name in ("size", "duration"):
        if getattr(dynamics, name) is None:
            raise SceneError(f"[dynamics] {name}: missing; accepted: beside {given[0]} a finite number > 0")
    if scene.chain is not None and abs(scene.chain.gamma) == 1:
        given_gamma = f"with gamma = {scene.chain.gamma!r} and without [family]"
        raise refusal("[dynamics]", given_gamma, "|gamma| < 1: sites off the edge have no image in the gauge")


def _check_kinds(dynamics: DynamicsTable, alone: bool) -> None:
    """One kind of perturbation, and its size."""
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if len(kinds) > 1:
        raise refusal("[dynamics]", " and ".join(kinds), "site, vector or seed, one of them or none")
    if kinds and dynamics.size is None:
        raise SceneError(f"[dynamics] size: missing; accepted: beside {kinds[0]} a finite number > 0")
    if dynamics.size is not None and not kinds and not alone:
        raise refusal("[dynamics] size", repr(dynamics.size), "beside one of site, vector, seed")
    if dynamics.vector is not None and not any(dynamics.vector):
        raise refusal("[dynamics] vector", "zeros", "a vector with a direction")


def _check_perturbation(chain: ChainTable, dynamics: DynamicsTable) -> None:
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if dynamics.site is not None and not 1 <= dynamics.site <= chain.sites:
        raise refusal("[dynamics] site", toml_repr(dynamics.site), f"whole numbers from 1 to {chain.sites} (sites)")
    if dynamics.vector is not None and len(dynamics.vector) not in (chain.sites, 2 * chain.sites):
        accepted = f"{chain.sites} displacements, or these and {chain.sites} velocities"
        raise refusal("[dynamics] vector", f"a list of {len(dynamics.vector)}", accepted)
    edge = chain.sites if chain.gamma > 0 else 1
    if abs(chain.gamma) == 1 and kinds and not _moves_alone(dynamics, int(edge), int(chain.sites)):
        reason = "at |gamma| = 1 displacements off the edge have no image in the gauge"
        raise refusal(f"[dynamics] {kinds[0]}", f"with gamma = {chain.gamma!r}", f"site {edge} alone ({reason})")


def _moves_alone(dynamics: DynamicsTable, edge: int, sites: int) -> bool:
    """Whether the perturbation moves the edge site alone; random displacements of several sites do not."""
    if dynamics.vector is not None:
        return not any(value for i, value in enumerate(dynamics.vector) if i % sites != edge - 1)
    return dynamics.site == edge or sites == 1


def check_export(scene: Scene) -> None:
    export = scene.export
    if export is None:
        return
    if scene.sites == math.inf:
        raise refusal("[export]", "with sites = inf", "with a whole number of sites")
    if export.c is None and export.fmu is None:
        raise refusal("[export]", "neither c nor fmu", "one of them, or both")
    if export.inputs and export.fmu is None:
        raise refusal("[export] inputs", toml_repr(list(export.inputs)), "beside fmu")
    if scene.chain is not None and export.c not in (None, "all") and abs(scene.chain.gamma) == 1:
        for part in export.c:
            if part in ("flow", "residual", "newton", "ipopt"):
                given = f"{toml_repr(part)} with gamma = {scene.chain.gamma!r}"
                accepted = "rhs, jacobian, variational, orbit (the gauge holds the edge site alone)"
                raise refusal("[export] c", given, accepted)
    if export.S is None:
        if export.mode is not None:
            raise refusal("[export] mode", toml_repr(export.mode), "beside S, the orbit of that mode's family")
        if scene.orbit is None and export.c is not None and "orbit" in export.c:
            raise refusal("[export] c", '"orbit" without S', "with S, that of the orbit")
        return
    if scene.family is None:
        raise refusal("[export] S", repr(export.S), "beside a [family], one of whose orbits it names")
    _check_orbit_of_family("export", scene, scene.family, export.S, export.mode)


def check_search(scene: Scene) -> None:
    search, chain = scene.search, scene.chain
    if search is None:
        return
    if scene.family is not None:
        raise refusal("[search]", "beside [family]", "[search] or [family] in one scene")
    if chain is None:
        return
    if chain.sites == math.inf:
        raise refusal("[search]", "with sites = inf", "with a whole number of sites")
    if chain.g == 0:
        raise refusal("[chain] g", repr(chain.g), "with a [search] a finite number other than 0")
    if isinstance(search.mode, int) and search.mode > chain.sites:
        raise refusal(
            "[search] mode", toml_repr(search.mode), f"whole numbers from 1 to {chain.sites} (sites), first, last"
        )
    check_known("[search] objective", search.objective, tuple(NAMED))
    for name in search.free:
        check_known("[search] free", name, tuple(FREE))
    for name, (lower, upper) in search.bounds.items():
        check_known("[search] bounds", name, tuple({**FREE, **NAMED}))
        if not lower <= upper:
            raise refusal(
                f"[search] bounds {name}", toml_repr([lower, upper]), "a list [lower, upper] with lower <= upper"
            )
    for item, held in enumerate(search.constraints, start=1):
        place = f"[search] constraints, item {item}"
        check_known(place, held.quantity, tuple(NAMED))
        if (held.equal is None) == (held.lower is None and held.upper is None):
            given = "equal beside a bound" if held.equal is not None else "neither equal nor a bound"
            raise refusal(place, given, "equal, or lower and upper or one of these")
