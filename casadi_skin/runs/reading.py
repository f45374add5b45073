"""Reading a scene from TOML: names first, then types and bounds by msgspec, then relations between keys."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import msgspec

from casadi_skin.model.arguments import LONGEST_VALUE_TEXT, cut, nearest
from casadi_skin.runs.axes import check_map, with_axes
from casadi_skin.runs.rules import (
    SceneError,
    Unknown,
    check_scene,
    check_unknown,
    did_you_mean,
    inline,
    is_table,
    refusal,
    toml_repr,
    with_kind,
)
from casadi_skin.runs.scene import (
    TABLES,
    BondTable,
    ChainTable,
    CurveTable,
    RangeTable,
    Scene,
    SearchCondition,
    SiteTable,
    Table,
    UniformTable,
    accepted_by,
    words,
)

MODEL_TABLES = ("chain", "lattice", "model")  # tables of which a scene has one
PARTS = (SiteTable, BondTable, UniformTable, CurveTable, SearchCondition, RangeTable)  # of tables
LATTICE_PARTS: Mapping[str, type[Table]] = {"site": SiteTable, "bond": BondTable}
KEY_SYNONYMS = {  # letters of papers and words of other programs, in lower case, for keys
    "n": "sites",
    "length": "sites",
    "s_max": "amplitude_max",
    "smax": "amplitude_max",
    "amplitude": "amplitude_max",
    "j": "mode",
    "tol": "tolerance",
    "rtol": "tolerance",
    "x0": "start",
    "guess": "start",
    "t": "period",
    "n_starts": "starts",
}


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
        scene = scene_of(_parse_toml(text))
        if scene.accuracy.certify:
            _check_decimals(text)
        return scene
    except SceneError as fault:
        raise SceneError(f"{source}: {fault}") from None


def _check_decimals(text: str) -> None:
    """Refuse numbers of the model and of S with more digits than doubles have: proofs are about the decimals given."""
    raw = tomllib.loads(text, parse_float=Decimal)
    for table in (*MODEL_TABLES, "family"):
        for key, value in raw.get(table, {}).items():
            for number in _leaves(value):
                if not isinstance(number, int | Decimal) or not Decimal(number).is_finite():
                    continue
                if Decimal(number) != Decimal(repr(float(number))):
                    accepted = f"with [accuracy] certify a number that a double is printed as, here {float(number)!r}"
                    raise refusal(f"[{table}] {key}", str(number), accepted)


def scene_of(raw: dict[str, Any]) -> Scene:
    """The scene that tables of plain values ask for, checked; raises SceneError."""
    raw = with_axes(raw)
    _check_names(raw)
    scene = _convert(raw)
    check_scene(scene)
    check_map(scene)
    return scene


def scene_schema() -> dict[str, Any]:
    """The JSON schema of a scene, for editors that complete and check TOML."""
    schema: dict[str, Any] = _without_null(msgspec.json.schema(Scene))
    tables: list[type[Table]] = [*TABLES.values(), *PARTS, Scene]
    for table in tables:
        definition = schema["$defs"][table.__name__]
        definition["description"] = definition["description"].partition("\n\n    Attributes:")[0]
        for key, (title, accepted) in words(table).items():
            definition["properties"][key] |= {"title": title, "description": accepted} if title else {}
    definition = schema["$defs"]["Scene"]
    definition["anyOf"] = [{"required": [name]} for name in MODEL_TABLES]
    of_map = schema["$defs"]["MapTable"]  # whose axes may stand in it by their own names
    of_map["additionalProperties"] = of_map["properties"]["axes"]["additionalProperties"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "casadi-skin scene", **schema}


def _without_null(value: Any) -> Any:
    """The schema without the choice null, which TOML does not have: editors then name the key that is wrong."""
    if isinstance(value, list):
        return [_without_null(item) for item in value if item != {"type": "null"}]
    if not isinstance(value, dict):
        return value
    found = {name: _without_null(item) for name, item in value.items() if not (name == "default" and item is None)}
    choices = found.get("anyOf", ())
    return {**{k: v for k, v in found.items() if k != "anyOf"}, **choices[0]} if len(choices) == 1 else found


def _parse_toml(text: str) -> dict[str, Any]:
    try:
        text.encode()  # refuses half a surrogate pair, which tomllib would let through
        return tomllib.loads(text)
    except RecursionError:
        reason = "nested too deeply"
    except ValueError as error:  # with line and column, but for an integer of thousands of digits
        reason = str(error).partition("; use sys.")[0]
        if len(reason) > 2 * LONGEST_VALUE_TEXT:  # a long name inside; line and column stand at the end
            reason = f"{reason[:LONGEST_VALUE_TEXT]}...{reason[-LONGEST_VALUE_TEXT:]}"
    raise SceneError(f"not TOML: {reason}")


def _check_names(raw: dict[str, Any]) -> None:
    """Refuse unknown tables and keys, values in place of tables, and keys that are required but missing."""
    check_unknown(_unknown_names(raw))
    models = [name for name in MODEL_TABLES if name in raw]
    if len(models) > 1:
        raise refusal(f"[{models[0]}]", f"beside [{models[1]}]", "[chain], [lattice] or [model] in one scene")
    if not models:
        keys = ", ".join(ChainTable.__struct_fields__)
        others = "a table [lattice] with cells and site, or a table [model] with file"
        raise SceneError(f"[chain]: missing; accepted: a table with {keys}, {others}")
    for place, table, given in _tables(raw):
        if not isinstance(given, dict):
            raise refusal(place, with_kind(given), f"one table {place}")
        for key, value in given.items():
            for number in _leaves(value):
                # no key takes an integer beyond the floats, and msgspec up to 0.20 raises SystemError on it
                if isinstance(number, int) and abs(number) > sys.float_info.max:
                    raise refusal(f"{place} {key}", toml_repr(number), accepted_by(table, key))
        for field in msgspec.structs.fields(table):
            if field.required and field.encode_name not in given:
                accepted = accepted_by(table, field.encode_name)
                raise SceneError(f"{place} {field.encode_name}: missing; accepted: {accepted}")
    for name in LATTICE_PARTS:
        items = raw.get("lattice", {}).get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise refusal(f"[lattice] {name}", with_kind(items), accepted_by(TABLES["lattice"], name))


def _tables(raw: dict[str, Any]) -> Iterator[tuple[str, type[Table], Any]]:
    """The place, the kind and the value of each table of a scene; of sites and bonds of a lattice those that are."""
    for name, table in TABLES.items():
        if name in raw:
            yield f"[{name}]", table, raw[name]
    lattice = raw.get("lattice")
    for name, part in LATTICE_PARTS.items():
        items = lattice.get(name) if isinstance(lattice, dict) else None
        for i, item in enumerate(items if isinstance(items, list) else (), start=1):
            if isinstance(item, dict):
                yield f"[[lattice.{name}]] {i}", part, item


def _unknown_names(raw: dict[str, Any]) -> Iterator[Unknown]:
    """Tables and keys that no scene has, in the order of the file."""
    places = {name: f"[{name}]" for name in TABLES} | {name: name for name in ("title", "time_limit")}
    known = {place: (table, given) for place, table, given in _tables(raw)}
    for name, value in raw.items():
        if name not in places:
            near, accepted = nearest(name, places), ", ".join(places.values())
            fault = f"[{cut(name)}]: unknown table" if is_table(value) else f"{cut(name)}: unknown key"
            yield Unknown(fault, near and places[near], accepted)
        elif name in TABLES:
            yield from _unknown_keys(places[name], *known.pop(places[name]))
    for place, (table, given) in known.items():
        yield from _unknown_keys(place, table, given)


def _unknown_keys(place: str, table: type[Table], given: object) -> Iterator[Unknown]:
    known = table.__struct_encode_fields__
    for key in given if isinstance(given, dict) else ():
        if key not in known:
            other = KEY_SYNONYMS.get(key.lower())
            near = other if other in known else nearest(key, known)
            yield Unknown(f"{place} {cut(key)}: unknown key", near and f"'{near}'", ", ".join(known) or "no keys")


def _leaves(value: object) -> Iterator[object]:
    """The values in a key, whatever tables and arrays they are in."""
    if not isinstance(value, list | dict):
        yield value
        return
    for item in value.values() if isinstance(value, dict) else value:
        yield from _leaves(item)


def _convert(raw: dict[str, Any]) -> Scene:
    """Let msgspec check types and bounds; the path in its message becomes our place."""
    try:
        return msgspec.convert(raw, Scene)
    except msgspec.ValidationError as error:
        message = str(error)
    path = re.search(r"`\$\.(?:lattice\.(site|bond)\[(\d+)\]\.)?(\w+)(?:\.(\w+))?(?:\[(\d+)\])?", message)
    if path is None:  # none is known; its own words are better than a wrong place
        raise SceneError(message)
    part, number, name, key, item = path.groups()
    if part:
        place, value = f"[[lattice.{part}]] {int(number) + 1} {name}", raw["lattice"][part][int(number)][name]
        raise refusal(place, with_kind(value), accepted_by(LATTICE_PARTS[part], name))
    value = raw[name][key] if key else raw[name]
    accepted = accepted_by(TABLES[name], key) if key else accepted_by(Scene, name)
    value, where = (value[int(item)], f" as item {int(item) + 1}") if item else (value, "")
    given = with_kind(value) if ", got `" in message else toml_repr(value)
    if isinstance(value, dict) and "a table" in accepted:  # a table it is, but what is in it is not accepted
        given = inline(value)
    near = nearest(value, re.findall(r'"(\w+)"', accepted)) if isinstance(value, str) else None
    place = f"[{name}] {key}" if key else name
    raise SceneError(f"{place}: given {given}{where}{did_you_mean(near and toml_repr(near), accepted)}")
