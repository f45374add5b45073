"""Reading a scene from TOML: names first, then types and bounds by msgspec, then what ties keys together."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from casadi_skin.scene.checks import (
    check_accuracy,
    check_degree,
    check_dynamics,
    check_export,
    check_family,
    check_search,
    check_walker,
)
from casadi_skin.scene.faults import (
    LONGEST,
    SceneError,
    accepted_words,
    cut,
    did_you_mean,
    inline,
    is_table,
    nearest,
    refusal,
    toml_repr,
    with_kind,
)
from casadi_skin.scene.model_checks import check_chain_tables, check_model_scene, check_model_tables
from casadi_skin.scene.model_tables import MODEL_TABLES, ModelScene
from casadi_skin.scene.tables import TABLES, ChainTable, Scene, Table

AnyScene = Scene | ModelScene
Kind = TypeVar("Kind", Scene, ModelScene)


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
        return _chain_scene(_parse_toml(text))
    except SceneError as fault:
        raise SceneError(f"{source}: {fault}") from None


def parse_any_scene(text: str, source: str = "scene") -> AnyScene:
    """Read a scene of a chain or, with [model] in it, of any model; raises SceneError as `parse_scene` does."""
    try:
        raw = _parse_toml(text)
        return _model_scene(raw) if "model" in raw else _chain_scene(raw, ", or a table [model] with file")
    except SceneError as fault:
        raise SceneError(f"{source}: {fault}") from None


def _chain_scene(raw: dict[str, Any], otherwise: str = "") -> Scene:
    check_model_tables(list(raw))
    _check_names(raw, TABLES)
    if "chain" not in raw:
        keys = ", ".join(ChainTable.__struct_fields__)
        raise SceneError(f"[chain]: missing; accepted: a table with {keys}{otherwise}")
    scene = _convert(raw, Scene, TABLES)
    check_accuracy(scene.accuracy)
    check_degree(scene.method)
    check_walker(scene.method)
    check_family(scene)
    check_dynamics(scene)
    check_search(scene)
    check_export(scene)
    return scene


def _model_scene(raw: dict[str, Any]) -> ModelScene:
    check_chain_tables(list(raw))
    _check_names(raw, MODEL_TABLES)
    scene = _convert(raw, ModelScene, MODEL_TABLES)
    check_model_scene(scene)
    return scene


def scene_schema() -> dict[str, Any]:
    """The JSON schema of a scene, for editors that complete and check TOML."""
    kinds, definitions = msgspec.json.schema_components([Scene, ModelScene], ref_template="#/$defs/{name}")
    return {"anyOf": list(kinds), "$defs": definitions}


def _parse_toml(text: str) -> dict[str, Any]:
    try:
        text.encode()  # refuses half a surrogate pair, which tomllib would let through
        return tomllib.loads(text)
    except RecursionError:
        reason = "nested too deeply"
    except ValueError as error:  # with line and column, but for an integer of thousands of digits
        reason = str(error).partition("; use sys.")[0]
        if len(reason) > 2 * LONGEST:  # a long name inside; line and column stand at the end
            reason = f"{reason[:LONGEST]}...{reason[-LONGEST:]}"
    raise SceneError(f"not TOML: {reason}")


def _check_names(raw: dict[str, Any], tables: Mapping[str, type[Table]]) -> None:
    """Refuse unknown tables and keys, values in place of tables, and what is required but missing."""
    places = {name: f"[{name}]" for name in tables} | {"title": "title"}
    for name, value in raw.items():
        if name not in places:
            fault = f"[{cut(name)}]: unknown table" if is_table(value) else f"{cut(name)}: unknown key"
            near = nearest(name, [*places, "model"])
            raise SceneError(fault + did_you_mean(near and places.get(near, f"[{near}]"), ", ".join(places.values())))
    for name, table in tables.items():
        if name in raw:
            _check_keys(name, table, raw[name])


def _check_keys(name: str, table: type[Table], given: object) -> None:
    if not isinstance(given, dict):
        raise refusal(f"[{name}]", with_kind(given), f"one table [{name}]")
    known = table.__struct_fields__
    for key, value in given.items():
        if key not in known:
            near = nearest(key, known)
            hint = did_you_mean(near and f"'{near}'", ", ".join(known) or "no keys")
            raise SceneError(f"[{name}] {cut(key)}: unknown key{hint}")
        for number in _leaves(value):
            # no key takes an integer beyond the floats, and msgspec up to 0.20 raises SystemError on it
            if isinstance(number, int) and abs(number) > sys.float_info.max:
                raise refusal(f"[{name}] {key}", toml_repr(number), accepted_words(table, key))
    for field in msgspec.structs.fields(table):
        if field.required and field.name not in given:
            raise SceneError(f"[{name}] {field.name}: missing; accepted: {accepted_words(table, field.name)}")


def _leaves(value: object) -> Iterator[object]:
    """The values in a key, whatever tables and arrays they are in."""
    if not isinstance(value, list | dict):
        yield value
        return
    for item in value.values() if isinstance(value, dict) else value:
        yield from _leaves(item)


def _convert(raw: dict[str, Any], kind: type[Kind], tables: Mapping[str, type[Table]]) -> Kind:
    """Let msgspec check types and bounds; the path in its message becomes our place."""
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        message = str(error)
    path = re.search(r"`\$\.(\w+)(?:\.(\w+))?(?:\[(\d+)\])?", message)
    if path is None:  # none is known; its own words are better than a wrong place
        raise SceneError(message)
    name, key, item = path.groups()
    value = raw[name][key] if key else raw[name]
    accepted = accepted_words(tables[name], key) if key else accepted_words(kind, name)
    value, where = (value[int(item)], f" as item {int(item) + 1}") if item else (value, "")
    given = with_kind(value) if ", got `" in message else toml_repr(value)
    if isinstance(value, dict) and "a table" in accepted:  # a table it is, but what is in it is not accepted
        given = inline(value)
    near = nearest(value, re.findall(r'"(\w+)"', accepted)) if isinstance(value, str) else None
    place = f"[{name}] {key}" if key else name
    raise SceneError(f"{place}: given {given}{where}{did_you_mean(near and toml_repr(near), accepted)}")
