"""Reading a scene from TOML: names first, then types and bounds by msgspec, then relations between keys."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from casadi_skin.model.arguments import LONGEST_VALUE_TEXT, cut, did_you_mean, nearest
from casadi_skin.model.loading import read_text as read_text_file
from casadi_skin.runs.rules import (
    SceneError,
    Unknown,
    check_scene,
    check_unknown,
    faults_at,
    in_file,
    inline,
    is_table,
    refusal,
    toml_repr,
    with_kind,
)
from casadi_skin.runs.scene import (
    ACCEPTED_AXES,
    OPTIONS,
    TABLES,
    AxisList,
    BondTable,
    ChainTable,
    MapTable,
    RangeTable,
    Scene,
    SiteTable,
    Table,
    accepted_by,
    words,
)

MODEL_TABLES = ("chain", "lattice", "model")  # tables of which a scene has one
LATTICE_PARTS: Mapping[str, type[Table]] = {"[lattice] site": SiteTable, "[lattice] bond": BondTable}
KEY_SYNONYMS = {  # letters of papers and words of other programs, in lower case, for keys
    "n": "sites", "length": "sites", "s_max": "amplitude_max", "smax": "amplitude_max", "amplitude": "amplitude_max",
    "j": "mode", "tol": "tolerance", "rtol": "tolerance", "x0": "start", "guess": "start", "t": "period",
    "n_starts": "starts",
}  # fmt: skip


def read_scene(path: str | Path) -> Scene:
    """Read the scene in a TOML file; raises SceneError where the file is missing, unreadable or wrong."""
    return parse_scene(read_text(path), str(path) or ".")


def read_text(path: str | Path) -> str:
    """Read the text of a scene file; raises SceneError where the file is missing or unreadable."""
    with faults_at(""):
        return read_text_file(Path(path), "TOML", "utf-8-sig")  # some editors begin UTF-8 with a byte-order mark


def parse_scene(text: str, source: str = "scene") -> Scene:
    """Read a scene from TOML text; raises SceneError whose message begins with the source."""
    with in_file(source):
        scene = scene_of(_parse_toml(text))
        if scene.accuracy.certify:
            _check_decimals(text)
        return scene


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
    """The scene that tables of plain values ask for.

    Raises SceneError: first for names that no scene has, then for the model, then for values, then for relations.
    """
    reading = _Reading()
    scene: Scene = reading.table(Scene, "", raw)
    check_unknown(reading.unknown)
    models = [name for name in MODEL_TABLES if name in raw]
    if len(models) > 1:
        raise refusal(f"[{models[0]}]", f"beside [{models[1]}]", "[chain], [lattice] or [model] in one scene")
    if not models:
        keys = ", ".join(ChainTable.__struct_fields__)
        others = "a table [lattice] with cells and site, or a table [model] with file"
        raise SceneError(f"[chain]: missing; accepted: a table with {keys}, {others}")
    for fault in reading.faults:
        raise fault
    check_scene(scene)
    return scene


def scene_schema() -> dict[str, Any]:
    """The JSON schema of a scene, for editors that complete and check TOML."""
    schema: dict[str, Any] = _without_null(msgspec.json.schema(Scene))
    for table in Table.__subclasses__():
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


def _leaves(value: object) -> Iterator[object]:
    """The values in a key, whatever tables and arrays they are in."""
    if not isinstance(value, list | dict):
        yield value
        return
    for item in value.values() if isinstance(value, dict) else value:
        yield from _leaves(item)


_keys = cache(msgspec.structs.fields)


@dataclass
class _Reading:
    """One way through the tables of a scene, which are converted key by key, so that each fault has its place."""

    unknown: list[Unknown] = field(default_factory=list)  # names that no scene has, which are reported first
    faults: list[SceneError] = field(default_factory=list)

    def table(self, kind: type[Table], place: str, given: Any) -> Any:
        """A table from plain values; nothing where it has a fault."""
        before, values = len(self.faults), dict[str, Any]()
        given = self._with_axes(given) if kind is MapTable else given
        if not isinstance(given, dict):
            self.faults.append(refusal(place, with_kind(given), f"one table {place}"))
            return None
        keys = {key.encode_name: key for key in _keys(kind)}
        known = {key: key if place or key not in TABLES else f"[{key}]" for key in keys}
        for name, value in given.items():
            if name not in keys:
                other = KEY_SYNONYMS.get(name.lower()) if place else None
                near = other if other in known else nearest(name, known)
                shown = near and (f"'{near}'" if place else known[near])
                table = not place and is_table(value)
                fault = f"[{cut(name)}]: unknown table" if table else f"{place} {cut(name)}: unknown key".lstrip()
                self.unknown.append(Unknown(fault, shown, ", ".join(known.values()) or "no keys"))
            elif name in TABLES and not place:
                values[name] = self.table(TABLES[name], f"[{name}]", value)
            elif kind is MapTable and name == "axes" and isinstance(value, dict):
                values[name] = {axis: self._axis(axis, item) for axis, item in value.items()}
            else:
                values[keys[name].name] = self._value(kind, keys[name], f"{place} {name}".lstrip(), value)
        for name in (name for name, key in keys.items() if key.required and name not in given):
            self.faults.append(SceneError(f"{place} {name}: missing; accepted: {accepted_by(kind, name)}"))
        return kind(**values) if len(self.faults) == before else None

    def _value(self, kind: type[Table], key: msgspec.structs.FieldInfo, place: str, value: Any) -> Any:
        """The value of a key; msgspec checks its type and bounds."""
        part, where = LATTICE_PARTS.get(place), ""
        if part and isinstance(value, list) and all(isinstance(item, dict) for item in value):
            for i, item in enumerate(value, start=1):
                self.table(part, f"[{place.replace('] ', '.')}]] {i}", item)
        try:
            return _taken(value, key.type)
        except msgspec.ValidationError as error:
            message, value = str(error.args[0]), error.args[1] if len(error.args) > 1 else value
        accepted = accepted_by(kind, key.encode_name)
        whole = part or kind in LATTICE_PARTS.values()  # of sites and bonds values are shown as they are
        item = None if whole else re.search(r"`\$\[(\d+)\]", message)
        if item:
            value, where = value[int(item[1])], f" as item {int(item[1]) + 1}"
        given = with_kind(value) if whole or ", got `" in message else toml_repr(value)
        if isinstance(value, dict) and "a table" in accepted:  # a table it is, but what is in it is not accepted
            given = inline(value)
        near = nearest(value, re.findall(r'"(\w+)"', accepted)) if isinstance(value, str) else None
        end = did_you_mean(near and toml_repr(near), accepted)
        self.faults.append(SceneError(f"{place}: given {given}{where}; {end}"))
        return None

    def _with_axes(self, given: Any) -> Any:
        """The keys of [map], those that are no options among its axes."""
        if not isinstance(given, dict) or not isinstance(axes := given.get("axes", {}), dict):
            return given
        own = {name: value for name, value in given.items() if name not in OPTIONS}
        again = (name for name in own if name in axes)
        self.faults += [refusal(f"[map] {cut(name)}", "again in its axes", "each parameter once") for name in again]
        return {**{name: value for name, value in given.items() if name not in own}, "axes": {**axes, **own}}

    def _axis(self, name: str, value: Any) -> Any:
        """An axis of a map: a range, or a list; nothing where it has a fault."""
        place = f"[map] {cut(name)}"
        if isinstance(value, dict):
            return self.table(RangeTable, f"{place},", value)
        try:
            return _taken(value, AxisList)
        except msgspec.ValidationError:
            words = f"{toml_repr(value)}; accepted: a list of one or more finite numbers or names"
            if not isinstance(value, list):
                words = f"{with_kind(value)}; {did_you_mean(nearest(name, OPTIONS), ACCEPTED_AXES)}"
            self.faults.append(SceneError(f"{place}: given {words}"))
            return None


def _taken(value: Any, kind: Any) -> Any:
    """What msgspec makes of a value; raises ValidationError for others, with the integer that no float reaches."""
    huge = (leaf for leaf in _leaves(value) if isinstance(leaf, int) and abs(leaf) > sys.float_info.max)
    found = next(huge, None)
    if found is not None:  # no key takes it, and msgspec up to 0.20 raises SystemError on it
        raise msgspec.ValidationError("", found)
    return msgspec.convert(value, kind)
