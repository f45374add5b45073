"""A scene: what is asked for, declared in TOML, read into frozen objects or refused in one line.

msgspec checks types and the bounds in the annotations; the code here names the place of a fault and the
nearest known name, and checks what ties one key to another. In each `Meta` the title says what a key is, the
description what it accepts: messages and the JSON schema quote it. The model is dimensionless.
"""

import difflib
import json
import math
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args, get_type_hints

import msgspec
from msgspec import Meta, Struct

Preset = Literal["draft", "standard", "reference"]
Transcription = Literal["trigonometric", "gauss"]
Corrector = Literal["ipopt", "newton"]
Walker = Literal["arclength"]
Flow = Literal["splitting", "cvodes"]
Evolver = Literal["cvodes", "dop853", "symplectic"]

PRESETS: tuple[str, ...] = get_args(Preset)
TRANSCRIPTIONS: tuple[str, ...] = get_args(Transcription)
CORRECTORS: tuple[str, ...] = get_args(Corrector)
WALKERS: tuple[str, ...] = get_args(Walker)
FLOWS: tuple[str, ...] = get_args(Flow)
EVOLVERS: tuple[str, ...] = get_args(Evolver)
PRESET_TOLERANCES: Mapping[str, float] = MappingProxyType({"draft": 1e-4, "standard": 1e-8, "reference": 1e-12})

_LONGEST = 60  # characters of a given value or name that a message shows
_MAX_SITES = 10_000_000
_MAX_SAMPLES = 1_000_000
_LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics


def _one_of(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


# A bound at the largest float is how msgspec is made to refuse inf; nan fails every comparison.
_Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
_Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]
_Sites = Annotated[int, Meta(ge=1, le=_MAX_SITES)]
_Mode = Annotated[int, Meta(extra_json_schema={"minimum": 1})]  # checked below, where sites is known
_Modes = Annotated[tuple[_Mode, ...], Meta(min_length=1)]
_Tolerance = Annotated[float, Meta(ge=1e-13, le=1e-2)]


class _Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scene: immutable, every key by name, no other key."""


class ChainTable(_Table, frozen=True):
    """The chain: its length, stiffness, nonreciprocity and nonlinearity."""

    sites: Annotated[_Sites, Meta(title="Sites N", description=f"a whole number >= 1 and <= {_MAX_SITES}")]
    alpha: Annotated[_Finite, Meta(title="On-site stiffness", description="a finite number")]
    gamma: Annotated[float, Meta(ge=-1, le=1, title="Nonreciprocity", description="a number >= -1 and <= 1")]
    g: Annotated[_Finite, Meta(title="Cubic on-site coefficient", description="a finite number")]


class SpectrumTable(_Table, frozen=True):
    """Linear frequencies and modes are asked for; there is nothing to set."""


class FamilyTable(_Table, frozen=True):
    """The families to follow, each from the linear mode that it grows from."""

    mode: Annotated[
        _Mode | _Modes,
        Meta(title="Linear modes", description="a mode from 1 to sites, or a list of such modes"),
    ]
    amplitude_max: Annotated[_Positive, Meta(title="Largest S = ||y||^2", description="a finite number > 0")]
    at: Annotated[
        tuple[_Positive, ...],
        Meta(title="Points at these S", description="a list of numbers > 0, ascending up to amplitude_max"),
    ] = ()
    film: Annotated[
        bool,
        Meta(title="Film (GIF) of the mode at the last point of `at`, or else at the end", description="true or false"),
    ] = False

    @property
    def modes(self) -> tuple[int, ...]:
        """The modes asked for, as a tuple also where one number was given."""
        return (self.mode,) if isinstance(self.mode, int) else self.mode


class StabilityTable(_Table, frozen=True):
    """Floquet multipliers along the families are asked for."""

    events: Annotated[bool, Meta(title="Locate changes of stability", description="true or false")] = True
    vectors: Annotated[
        bool, Meta(title="Keep the Floquet vectors at the points of `at`", description="true or false")
    ] = False


class DynamicsTable(_Table, frozen=True):
    """The time evolution of one orbit, perturbed or not, from the phase where all velocities vanish."""

    S: Annotated[_Positive, Meta(title="S of the orbit", description="a finite number > 0, up to amplitude_max")]
    mode: Annotated[
        _Mode | None,
        Meta(title="Mode of its family", description="one of the modes of [family]; required where these are several"),
    ] = None
    duration: Annotated[_Positive | None, Meta(title="Time to its end", description="a finite number > 0")] = None
    periods: Annotated[
        _Positive | None, Meta(title="Periods of the orbit to its end", description="a finite number > 0")
    ] = None
    samples: Annotated[
        Annotated[int, Meta(ge=2, le=_MAX_SAMPLES)] | None,
        Meta(
            title="Number of times written, first and last included",
            description=f"a whole number >= 2 and <= {_MAX_SAMPLES} (left out: 20 a period, 401 to 4001 in all)",
        ),
    ] = None
    method: Annotated[Evolver, Meta(title="Integrator", description=_one_of(EVOLVERS))] = "cvodes"
    tolerance: Annotated[
        _Tolerance, Meta(title="Relative tolerance of one step", description="a number >= 1e-13 and <= 1e-2")
    ] = 1e-11
    size: Annotated[
        _Positive | None,
        Meta(title="Norm of the perturbation", description="a finite number > 0, with one of site, vector, seed"),
    ] = None
    site: Annotated[_Mode | None, Meta(title="Displaced site", description="a site from 1 to sites")] = None
    vector: Annotated[
        Annotated[tuple[_Finite, ...], Meta(min_length=1)] | None,
        Meta(
            title="Direction of the perturbation",
            description="a list of numbers: a displacement a site, or these and a velocity a site",
        ),
    ] = None
    seed: Annotated[
        Annotated[int, Meta(ge=0, le=2**63 - 1)] | None,
        Meta(title="Seed of random displacements", description="a whole number >= 0 and < 2^63"),
    ] = None


class AccuracyTable(_Table, frozen=True):
    """The relative error allowed in the results, by a preset or as a number."""

    preset: Annotated[Preset | None, Meta(title="Named tolerance", description=_one_of(PRESETS))] = None
    tolerance: Annotated[
        _Tolerance | None, Meta(title="Relative tolerance", description="a number >= 1e-13 and <= 1e-2")
    ] = None

    @property
    def relative_tolerance(self) -> float:
        """The tolerance that holds: the number, else that of the preset, else that of "standard"."""
        return PRESET_TOLERANCES[self.preset or "standard"] if self.tolerance is None else self.tolerance


class MethodTable(_Table, frozen=True):
    """The interchangeable methods, by name."""

    transcription: Annotated[Transcription, Meta(title="Discretisation", description=_one_of(TRANSCRIPTIONS))] = (
        "trigonometric"
    )
    corrector: Annotated[Corrector, Meta(title="Solver of a point", description=_one_of(CORRECTORS))] = "ipopt"
    walker: Annotated[Walker, Meta(title="Way along a family", description=_one_of(WALKERS))] = "arclength"
    flow: Annotated[Flow, Meta(title="Flow map of stability", description=_one_of(FLOWS))] = "splitting"


class Scene(_Table, frozen=True):
    """All that one run is asked for; what is None is neither built nor computed."""

    chain: ChainTable
    spectrum: SpectrumTable | None = None
    family: FamilyTable | None = None
    stability: StabilityTable | None = None
    dynamics: DynamicsTable | None = None
    accuracy: AccuracyTable = msgspec.field(default_factory=AccuracyTable)
    method: MethodTable = msgspec.field(default_factory=MethodTable)
    title: Annotated[str | None, Meta(title="Title of the results", description="a string")] = None

    def same_request(self, other: "Scene") -> bool:
        """Whether the other scene is equal but for the title."""
        return msgspec.structs.replace(self, title=None) == msgspec.structs.replace(other, title=None)


_TABLES: Mapping[str, type[_Table]] = MappingProxyType(
    {
        "chain": ChainTable,
        "spectrum": SpectrumTable,
        "family": FamilyTable,
        "stability": StabilityTable,
        "dynamics": DynamicsTable,
        "accuracy": AccuracyTable,
        "method": MethodTable,
    }
)


class SceneError(ValueError):
    """A scene that cannot be used: one line with file, table and key, what was given and is accepted."""

    def __init__(self, message: str) -> None:
        # Names and values come from a file and may hold any character: escaped, the message stays one line.
        super().__init__("".join(char if char.isprintable() else ascii(char)[1:-1] for char in message))


def read_scene(path: str | Path) -> Scene:
    """Read the scene in a TOML file; raises SceneError where the file is missing, unreadable or wrong."""
    return parse_scene(read_text(path), str(path) or ".")


def read_text(path: str | Path) -> str:
    """Read the text of a scene file; raises SceneError where the file is missing or unreadable."""
    source = str(path) or "."
    try:
        return Path(path).read_bytes().decode("utf-8-sig")  # some editors begin UTF-8 with a byte-order mark
    except UnicodeDecodeError as error:
        raise SceneError(f"{source}: not UTF-8 at byte {error.start}; accepted: TOML in UTF-8") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{source}: cannot be read: {reason}; accepted: a file in TOML") from None


def parse_scene(text: str, source: str = "scene") -> Scene:
    """Read a scene from TOML text; raises SceneError whose message begins with the source."""
    try:
        raw = _parse_toml(text)
        _check_names(raw)
        scene = _convert(raw)
        _check_accuracy(scene.accuracy)
        _check_family(scene)
        _check_dynamics(scene)
    except SceneError as fault:
        raise SceneError(f"{source}: {fault}") from None
    return scene


def scene_schema() -> dict[str, Any]:
    """The JSON schema of a scene, for editors that complete and check TOML."""
    return msgspec.json.schema(Scene)


def _parse_toml(text: str) -> dict[str, Any]:
    try:
        text.encode()  # refuses half a surrogate pair, which tomllib would let through
        return tomllib.loads(text)
    except RecursionError:
        reason = "nested too deeply"
    except ValueError as error:  # with line and column, but for an integer of thousands of digits
        reason = str(error).partition("; use sys.")[0]
        if len(reason) > 2 * _LONGEST:  # a long name inside; line and column stand at the end
            reason = f"{reason[:_LONGEST]}...{reason[-_LONGEST:]}"
    raise SceneError(f"not TOML: {reason}")


def _check_names(raw: dict[str, Any]) -> None:
    """Refuse unknown tables and keys, values in place of tables, and what is required but missing."""
    places = {name: f"[{name}]" for name in _TABLES} | {"title": "title"}
    for name, value in raw.items():
        if name not in places:
            fault = f"[{_cut(name)}]: unknown table" if _is_table(value) else f"{_cut(name)}: unknown key"
            near = _nearest(name, places)
            raise SceneError(fault + _hint(near and places[near], ", ".join(places.values())))
    for name, table in _TABLES.items():
        if name in raw:
            _check_keys(name, table, raw[name])
    if "chain" not in raw:
        raise SceneError(f"[chain]: missing; accepted: a table with {', '.join(ChainTable.__struct_fields__)}")


def _check_keys(name: str, table: type[_Table], given: object) -> None:
    if not isinstance(given, dict):
        raise _refusal(f"[{name}]", _with_kind(given), f"one table [{name}]")
    known = table.__struct_fields__
    for key, value in given.items():
        if key not in known:
            near = _nearest(key, known)
            hint = _hint(near and f"'{near}'", ", ".join(known) or "no keys")
            raise SceneError(f"[{name}] {_cut(key)}: unknown key{hint}")
        for number in value if isinstance(value, list) else [value]:
            # no key takes an integer beyond the floats, and msgspec up to 0.20 raises SystemError on it
            if isinstance(number, int) and abs(number) > sys.float_info.max:
                raise _refusal(f"[{name}] {key}", _shown(number), _accepted(table, key))
    for field in msgspec.structs.fields(table):
        if field.required and field.name not in given:
            raise SceneError(f"[{name}] {field.name}: missing; accepted: {_accepted(table, field.name)}")


def _convert(raw: dict[str, Any]) -> Scene:
    """Let msgspec check types and bounds; the path in its message becomes our place."""
    try:
        return msgspec.convert(raw, Scene)
    except msgspec.ValidationError as error:
        message = str(error)
    path = re.search(r"`\$\.(\w+)(?:\.(\w+))?(?:\[(\d+)\])?", message)
    if path is None:  # none is known; its own words are better than a wrong place
        raise SceneError(message)
    name, key, item = path.groups()
    value = raw[name][key] if key else raw[name]
    accepted = _accepted(_TABLES[name], key) if key else _accepted(Scene, name)
    value, where = (value[int(item)], f" as item {int(item) + 1}") if item else (value, "")
    given = _with_kind(value) if ", got `" in message else _shown(value)
    near = _nearest(value, re.findall(r'"(\w+)"', accepted)) if isinstance(value, str) else None
    place = f"[{name}] {key}" if key else name
    raise SceneError(f"{place}: given {given}{where}{_hint(near and _shown(near), accepted)}")


def _check_accuracy(accuracy: AccuracyTable) -> None:
    if accuracy.preset is not None and accuracy.tolerance is not None:
        given = f'preset = "{accuracy.preset}" and tolerance = {accuracy.tolerance!r}'
        raise _refusal("[accuracy]", given, "preset or tolerance, one of them or neither")


def _check_family(scene: Scene) -> None:
    chain, family = scene.chain, scene.family
    if family is None:
        if scene.stability is not None:
            raise _refusal("[stability]", "without [family]", "beside a [family], whose stability it asks for")
        return
    _check_modes(chain, family.modes)
    if chain.g == 0:
        reason = "the family would be the linear mode at every amplitude"
        raise _refusal("[chain] g", repr(chain.g), f"with a [family] a finite number other than 0 ({reason})")
    for mode in family.modes:
        _check_gauge(chain, mode)
        _check_frequency(chain, mode)
    _check_at(family)


def _check_modes(chain: ChainTable, modes: tuple[int, ...]) -> None:
    seen: set[int] = set()
    for mode in modes:
        if not 1 <= mode <= chain.sites:
            raise _refusal("[family] mode", _shown(mode), f"whole numbers from 1 to {chain.sites} (sites)")
        if mode in seen:
            raise _refusal("[family] mode", f"{mode} more than once", "each mode once")
        seen.add(mode)


def _check_gauge(chain: ChainTable, mode: int) -> None:
    """Refuse the modes that have no family at |gamma| = 1, where every coupling acts one way only."""
    only = chain.sites if chain.g > 0 else 1
    if abs(chain.gamma) == 1 and mode != only:
        reason = (
            "at |gamma| = 1 all frequencies meet and only mode N (g > 0) or mode 1 (g < 0), "
            "in which the edge site alone moves, can be followed"
        )
        raise _refusal("[family] mode", f"mode {mode} with gamma = {chain.gamma!r}", f"mode {only} ({reason})")


def _check_frequency(chain: ChainTable, mode: int) -> None:
    """Refuse a mode that does not oscillate: omega_j^2 = 2 + alpha - 2 s cos(j pi/(N+1)) <= 0."""
    s = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
    # 2 - 2 s cos(q) without subtracting equal numbers: 1 - s = gamma^2/(1 + s), 1 - cos(q) = 2 sin^2(q/2)
    stiffness = 2 * chain.gamma**2 / (1 + s) + 4 * s * math.sin(mode * math.pi / (2 * chain.sites + 2)) ** 2
    if chain.alpha + stiffness <= 0:
        given = f"mode {mode}, which has omega^2 = {chain.alpha + stiffness:.6g} at alpha = {chain.alpha!r}"
        accepted = f"modes with omega^2 > 0; for mode {mode}: alpha > {-stiffness:.12g}"
        raise _refusal("[family] mode", given, accepted)


def _check_at(family: FamilyTable) -> None:
    for item, value in enumerate(family.at, start=1):
        if value > family.amplitude_max:
            accepted = f"numbers <= amplitude_max = {family.amplitude_max!r}"
            raise _refusal("[family] at", f"{value!r} as item {item}", accepted)
        if item > 1 and value <= family.at[item - 2]:
            given = f"{value!r} as item {item} after {family.at[item - 2]!r}"
            raise _refusal("[family] at", given, "numbers in strictly ascending order")


def _check_dynamics(scene: Scene) -> None:
    family, dynamics = scene.family, scene.dynamics
    if dynamics is None:
        return
    if family is None:
        raise _refusal("[dynamics]", "without [family]", "beside a [family], one of whose orbits it follows in time")
    modes = f"one of the modes of [family], {_shown(list(family.modes))}"
    if dynamics.mode is None and len(family.modes) > 1:
        raise SceneError(f"[dynamics] mode: missing; accepted: {modes}")
    if dynamics.mode is not None and dynamics.mode not in family.modes:
        raise _refusal("[dynamics] mode", _shown(dynamics.mode), modes)
    if family.amplitude_max < dynamics.S:
        raise _refusal("[dynamics] S", repr(dynamics.S), f"a number <= amplitude_max = {family.amplitude_max!r}")
    if (dynamics.duration is None) == (dynamics.periods is None):
        given = "neither duration nor periods" if dynamics.duration is None else "duration and periods"
        raise _refusal("[dynamics]", given, "duration or periods, one of them")
    _check_envelope(scene.chain)
    _check_perturbation(scene.chain, dynamics)


def _check_envelope(chain: ChainTable) -> None:
    """Refuse chains whose displacements at the far end are below the smallest double."""
    if abs(chain.gamma) < 1 and (chain.sites - 1) * math.atanh(abs(chain.gamma)) > _LONGEST_ENVELOPE:
        given = f"with sites = {chain.sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"
        raise _refusal("[dynamics]", given, f"(sites - 1) artanh|gamma| <= {_LONGEST_ENVELOPE:g}")


def _check_perturbation(chain: ChainTable, dynamics: DynamicsTable) -> None:
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if len(kinds) > 1:
        raise _refusal("[dynamics]", " and ".join(kinds), "site, vector or seed, one of them or none")
    if kinds and dynamics.size is None:
        raise SceneError(f"[dynamics] size: missing; accepted: beside {kinds[0]} a finite number > 0")
    if dynamics.size is not None and not kinds:
        raise _refusal("[dynamics] size", repr(dynamics.size), "beside one of site, vector, seed")
    if dynamics.site is not None and not 1 <= dynamics.site <= chain.sites:
        raise _refusal("[dynamics] site", _shown(dynamics.site), f"whole numbers from 1 to {chain.sites} (sites)")
    if dynamics.vector is not None:
        if len(dynamics.vector) not in (chain.sites, 2 * chain.sites):
            accepted = f"{chain.sites} displacements, or these and {chain.sites} velocities"
            raise _refusal("[dynamics] vector", f"a list of {len(dynamics.vector)}", accepted)
        if not any(dynamics.vector):
            raise _refusal("[dynamics] vector", "zeros", "a vector with a direction")
    edge = chain.sites if chain.gamma > 0 else 1
    if abs(chain.gamma) == 1 and kinds and not _moves_alone(dynamics, edge, chain.sites):
        reason = "at |gamma| = 1 displacements off the edge have no image in the gauge"
        raise _refusal(f"[dynamics] {kinds[0]}", f"with gamma = {chain.gamma!r}", f"site {edge} alone ({reason})")


def _moves_alone(dynamics: DynamicsTable, edge: int, sites: int) -> bool:
    """Whether the perturbation moves the edge site alone; random displacements of several sites do not."""
    if dynamics.vector is not None:
        return not any(value for i, value in enumerate(dynamics.vector) if i % sites != edge - 1)
    return dynamics.site == edge or sites == 1


def _refusal(place: str, given: str, accepted: str) -> SceneError:
    return SceneError(f"{place}: given {given}; accepted: {accepted}")


def _hint(near: str | None, accepted: str) -> str:
    return f"; did you mean {near}? (accepted: {accepted})" if near else f"; accepted: {accepted}"


def _nearest(name: str, known: Iterable[str]) -> str | None:
    return next(iter(difflib.get_close_matches(name[:_LONGEST].lower(), list(known), n=1)), None)


def _accepted(table: type[_Table], key: str) -> str:
    meta: Meta = get_type_hints(table, include_extras=True)[key].__metadata__[-1]
    return meta.description or ""


def _is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and value != [] and isinstance(value[0], dict))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def _shown(value: object, depth: int = 3) -> str:
    """A value as TOML would write it, cut where it is long, nested or huge."""
    if isinstance(value, str):
        return _cut(json.dumps(value[:_LONGEST], ensure_ascii=False))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):  # beyond some hundred digits Python may refuse to write decimals, never hex
        return _cut(str(value) if value.bit_length() < 2000 else hex(value))
    if isinstance(value, list):
        items = [_shown(item, depth - 1) for item in value[:_LONGEST]] if depth else ["..."]
        return _cut(f"[{', '.join(items)}]")
    return "a table" if isinstance(value, dict) else str(value)


def _with_kind(value: object) -> str:
    """A value with the name of its TOML type, for where the type is the fault."""
    if _is_table(value):
        return "a table" if isinstance(value, dict) else "an array of tables"
    kinds = {bool: "a boolean", int: "a whole number", float: "a float", str: "a string", list: "an array"}
    return f"{_shown(value)} ({kinds.get(type(value), 'a date or time')})"
