"""What ties one key of a scene to another; bounds of single keys are in the tables."""

import math

from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.scene.faults import SceneError, did_you_mean, nearest, refusal, toml_repr
from casadi_skin.scene.tables import AccuracyTable, ChainTable, DynamicsTable, FamilyTable, MethodTable, Scene

NEAREST = 1e-12  # relative, of the end of a family to its start
NARROWEST_BAND = 1e-10  # the same as in orbits.request
LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics


def check_accuracy(accuracy: AccuracyTable) -> None:
    if accuracy.preset is not None and accuracy.tolerance is not None:
        given = f'preset = "{accuracy.preset}" and tolerance = {accuracy.tolerance!r}'
        raise refusal("[accuracy]", given, "preset or tolerance, one of them or neither")


def check_degree(method: MethodTable) -> None:
    if method.degree is not None and method.transcription not in ("gauss", "radau"):
        given = f'{method.degree} with transcription = "{method.transcription}"'
        raise refusal("[method] degree", given, 'with transcription = "gauss" or "radau" only')


def check_walker(method: MethodTable) -> None:
    if method.walker == "series" and method.transcription != "trigonometric":
        given = f'"series" with transcription = "{method.transcription}"'
        raise refusal("[method] walker", given, '"arclength", or transcription = "trigonometric"')


def check_family(scene: Scene) -> None:
    chain, family = scene.chain, scene.family
    if family is None:
        if scene.stability is not None:
            raise refusal("[stability]", "without [family]", "beside a [family], whose stability it asks for")
        return
    modes = family.modes(chain.sites)
    _check_modes(chain, modes)
    _check_infinite(scene)
    if chain.g == 0:
        reason = "the family would be the linear mode at every amplitude"
        raise refusal("[chain] g", repr(chain.g), f"with a [family] a finite number other than 0 ({reason})")
    for mode in modes:
        _check_gauge(chain, mode)
        _check_frequency(chain, mode)
        _check_period(chain, family, mode)
    _check_at(family)
    _check_at_periods(family)


def _check_modes(chain: ChainTable, modes: tuple[int, ...]) -> None:
    seen: set[int] = set()
    for mode in modes:
        if chain.sites == math.inf and mode != (-1 if chain.g > 0 else 1):
            only = f'"{"last" if chain.g > 0 else "first"}" (of an infinite chain, with g = {chain.g:g})'
            raise refusal(
                "[family] mode", '"last"' if mode == -1 else '"first"' if mode == 1 else toml_repr(mode), only
            )
        if chain.sites != math.inf and not 1 <= mode <= chain.sites:
            raise refusal(
                "[family] mode", toml_repr(mode), f"whole numbers from 1 to {chain.sites} (sites), first, last"
            )
        if mode in seen:
            raise refusal("[family] mode", f"{mode} more than once", "each mode once")
        seen.add(mode)


def _check_infinite(scene: Scene) -> None:
    """Refuse what needs every site of an infinite chain."""
    if scene.chain.sites != math.inf:
        return
    for name in ("spectrum", "stability", "dynamics"):
        if getattr(scene, name) is not None:
            raise refusal(f"[{name}]", "with sites = inf", "with a whole number of sites: all of them take part in it")


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
    stiffness = _stiffness(chain, mode)
    if chain.alpha + stiffness <= 0:
        given = f"mode {mode}, which has omega^2 = {chain.alpha + stiffness:.6g} at alpha = {chain.alpha!r}"
        accepted = f"modes with omega^2 > 0; for mode {mode}: alpha > {-stiffness:.12g}"
        raise refusal("[family] mode", given, accepted)
    s = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
    if chain.sites > 1 and 0 < 4 * s < NARROWEST_BAND * (chain.alpha + stiffness):
        reason = "beside a larger one doubles do not tell the modes of the band apart"
        accepted = f"with a [family] up to {4 * s / NARROWEST_BAND:.3g} ({reason})"
        raise refusal("[chain] alpha", repr(chain.alpha), accepted)


def _stiffness(chain: ChainTable, mode: int) -> float:
    """omega_j^2 - alpha."""
    s = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
    if chain.sites == math.inf:
        return 2 * chain.gamma**2 / (1 + s) + (0.0 if mode == 1 else 4 * s)
    # 2 - 2 s cos(q) without subtracting equal numbers: 1 - s = gamma^2/(1 + s), 1 - cos(q) = 2 sin^2(q/2)
    return 2 * chain.gamma**2 / (1 + s) + 4 * s * math.sin(mode * math.pi / (2 * chain.sites + 2)) ** 2


def _check_period(chain: ChainTable, family: FamilyTable, mode: int) -> None:
    """Refuse an end at a period that the linear mode, where the family starts, has or exceeds."""
    if family.period_max is None:
        return
    linear = 2 * math.pi / math.sqrt(chain.alpha + _stiffness(chain, mode))
    if family.period_max <= linear * (1 + NEAREST):
        accepted = f"a finite number > {linear:.12g} (the period of linear mode {mode})"
        raise refusal("[family] period_max", repr(family.period_max), accepted)


def _check_at_periods(family: FamilyTable) -> None:
    longest = math.inf if family.period_max is None else family.period_max
    for key, values in (("at_Omega", family.at_Omega), ("at_period", family.at_period)):
        for item, value in enumerate(values, start=1):
            if value in values[: item - 1]:
                raise refusal(f"[family] {key}", f"{value!r} as item {item} again", "each number once")
            if key == "at_period" and value > longest:
                accepted = f"numbers <= period_max = {longest!r}"
                raise refusal(f"[family] {key}", f"{value!r} as item {item}", accepted)
            if key == "at_Omega" and 2 * math.pi / value > longest:
                accepted = f"numbers >= 2 pi/period_max = {2 * math.pi / longest:.12g}"
                raise refusal(f"[family] {key}", f"{value!r} as item {item}", accepted)


def _check_at(family: FamilyTable) -> None:
    for item, value in enumerate(family.at, start=1):
        if value > family.amplitude_max:
            accepted = f"numbers <= amplitude_max = {family.amplitude_max!r}"
            raise refusal("[family] at", f"{value!r} as item {item}", accepted)
        if item > 1 and value <= family.at[item - 2]:
            given = f"{value!r} as item {item} after {family.at[item - 2]!r}"
            raise refusal("[family] at", given, "numbers in strictly ascending order")


def check_dynamics(scene: Scene) -> None:
    family, dynamics = scene.family, scene.dynamics
    if dynamics is None:
        return
    if family is None:
        raise refusal("[dynamics]", "without [family]", "beside a [family], one of whose orbits it follows in time")
    followed = family.modes(scene.chain.sites)
    modes = f"one of the modes of [family], {toml_repr(list(followed))}"
    if dynamics.mode is None and len(followed) > 1:
        raise SceneError(f"[dynamics] mode: missing; accepted: {modes}")
    if dynamics.mode is not None and dynamics.mode not in followed:
        raise refusal("[dynamics] mode", toml_repr(dynamics.mode), modes)
    if family.amplitude_max < dynamics.S:
        raise refusal("[dynamics] S", repr(dynamics.S), f"a number <= amplitude_max = {family.amplitude_max!r}")
    if (dynamics.duration is None) == (dynamics.periods is None):
        given = "neither duration nor periods" if dynamics.duration is None else "duration and periods"
        raise refusal("[dynamics]", given, "duration or periods, one of them")
    _check_envelope(scene.chain)
    _check_perturbation(scene.chain, dynamics)


def _check_envelope(chain: ChainTable) -> None:
    """Refuse chains whose displacements at the far end are below the smallest double."""
    if abs(chain.gamma) < 1 and (chain.sites - 1) * math.atanh(abs(chain.gamma)) > LONGEST_ENVELOPE:
        given = f"with sites = {chain.sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"
        raise refusal("[dynamics]", given, f"(sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}")


def _check_perturbation(chain: ChainTable, dynamics: DynamicsTable) -> None:
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if len(kinds) > 1:
        raise refusal("[dynamics]", " and ".join(kinds), "site, vector or seed, one of them or none")
    if kinds and dynamics.size is None:
        raise SceneError(f"[dynamics] size: missing; accepted: beside {kinds[0]} a finite number > 0")
    if dynamics.size is not None and not kinds:
        raise refusal("[dynamics] size", repr(dynamics.size), "beside one of site, vector, seed")
    if dynamics.site is not None and not 1 <= dynamics.site <= chain.sites:
        raise refusal("[dynamics] site", toml_repr(dynamics.site), f"whole numbers from 1 to {chain.sites} (sites)")
    if dynamics.vector is not None:
        if len(dynamics.vector) not in (chain.sites, 2 * chain.sites):
            accepted = f"{chain.sites} displacements, or these and {chain.sites} velocities"
            raise refusal("[dynamics] vector", f"a list of {len(dynamics.vector)}", accepted)
        if not any(dynamics.vector):
            raise refusal("[dynamics] vector", "zeros", "a vector with a direction")
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
    export, family = scene.export, scene.family
    if export is None:
        return
    if scene.chain.sites == math.inf:
        raise refusal("[export]", "with sites = inf", "with a whole number of sites")
    if export.c is None and export.fmu is None:
        raise refusal("[export]", "neither c nor fmu", "one of them, or both")
    if export.c not in (None, "all") and abs(scene.chain.gamma) == 1:
        for part in export.c:
            if part in ("flow", "residual", "newton", "ipopt"):
                given = f"{toml_repr(part)} with gamma = {scene.chain.gamma!r}"
                accepted = "rhs, jacobian, variational, orbit (the gauge holds the edge site alone)"
                raise refusal("[export] c", given, accepted)
    if export.S is None:
        if export.mode is not None:
            raise refusal("[export] mode", toml_repr(export.mode), "beside S, the orbit of that mode's family")
        if export.c is not None and "orbit" in export.c:
            raise refusal("[export] c", '"orbit" without S', "with S, that of the orbit")
        return
    if family is None:
        raise refusal("[export] S", repr(export.S), "beside a [family], one of whose orbits it names")
    followed = family.modes(scene.chain.sites)
    modes = f"one of the modes of [family], {toml_repr(list(followed))}"
    if export.mode is None and len(followed) > 1:
        raise SceneError(f"[export] mode: missing; accepted: {modes}")
    if export.mode is not None and export.mode not in followed:
        raise refusal("[export] mode", toml_repr(export.mode), modes)
    if family.amplitude_max < export.S:
        raise refusal("[export] S", repr(export.S), f"a number <= amplitude_max = {family.amplitude_max!r}")


def check_search(scene: Scene) -> None:
    search, chain = scene.search, scene.chain
    if search is None:
        return
    if scene.family is not None:
        raise refusal("[search]", "beside [family]", "[search] or [family] in one scene")
    if chain.sites == math.inf:
        raise refusal("[search]", "with sites = inf", "with a whole number of sites")
    if chain.g == 0:
        raise refusal("[chain] g", repr(chain.g), "with a [search] a finite number other than 0")
    if isinstance(search.mode, int) and search.mode > chain.sites:
        raise refusal(
            "[search] mode", toml_repr(search.mode), f"whole numbers from 1 to {chain.sites} (sites), first, last"
        )
    _check_known("[search] objective", search.objective, tuple(NAMED))
    for name in search.free:
        _check_known("[search] free", name, tuple(FREE))
    for name, (lower, upper) in search.bounds.items():
        _check_known("[search] bounds", name, tuple({**FREE, **NAMED}))
        if not lower <= upper:
            raise refusal(
                f"[search] bounds {name}", toml_repr([lower, upper]), "a list [lower, upper] with lower <= upper"
            )
    for item, held in enumerate(search.constraints, start=1):
        place = f"[search] constraints, item {item}"
        _check_known(place, held.quantity, tuple(NAMED))
        if (held.equal is None) == (held.lower is None and held.upper is None):
            given = "equal beside a bound" if held.equal is not None else "neither equal nor a bound"
            raise refusal(place, given, "equal, or lower and upper or one of these")


def _check_known(place: str, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        near = nearest(name, known)
        raise SceneError(f"{place}: given {toml_repr(name)}{did_you_mean(near and toml_repr(near), ', '.join(known))}")
