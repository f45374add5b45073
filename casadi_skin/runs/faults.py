"""Reports of faults of a scene: one line with the place, the value and the accepted values."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, get_type_hints

from msgspec import Meta

from casadi_skin.model.arguments import LONGEST, cut, nearest
from casadi_skin.runs.output import InputError
from casadi_skin.runs.scene_tables import Table

LONGEST_LIST = 400  # characters of a message on several names


class SceneError(InputError):
    """A scene that cannot be used: one line with file, table and key, the given and the accepted values."""

    def __init__(self, message: str) -> None:
        # Names and values come from a file and may hold any character: escaped, the message stays one line.
        super().__init__("".join(char if char.isprintable() else ascii(char)[1:-1] for char in message))


def refusal(place: str, given: str, accepted: str) -> SceneError:
    return SceneError(f"{place}: given {given}; accepted: {accepted}")


def did_you_mean(near: str | None, accepted: str) -> str:
    return f"; did you mean {near}? (accepted: {accepted})" if near else f"; accepted: {accepted}"


class Unknown(NamedTuple):
    """A table or key that no scene has: its place, the nearest known name and all that are accepted there."""

    fault: str
    near: str | None
    accepted: str


def check_unknown(found: Iterable[Unknown]) -> None:
    """Raises SceneError for unknown names: one with all that is accepted, several with the nearest names alone."""
    names = list(found)
    if len(names) == 1:
        raise SceneError(names[0].fault + did_you_mean(names[0].near, names[0].accepted))
    shown, words = 0, ""
    for name in names:
        more = f"{'; ' if words else ''}{name.fault}{f', did you mean {name.near}?' if name.near else ''}"
        if len(words) + len(more) > LONGEST_LIST:
            break
        shown, words = shown + 1, words + more
    if names:
        raise SceneError(words + (f"; and {len(names) - shown} more" if shown < len(names) else ""))


def check_known(place: str, name: str, known: Sequence[str]) -> None:
    """Raises SceneError, with the nearest known name, for an unknown one."""
    if name not in known:
        near = nearest(name, known)
        hint = did_you_mean(near and toml_repr(near), ", ".join(known) or "none")
        raise SceneError(f"{place}: given {toml_repr(name)}{hint}")


def accepted_words(table: type[Table], key: str) -> str:
    name = dict(zip(table.__struct_encode_fields__, table.__struct_fields__, strict=True))[key]
    meta: Meta = get_type_hints(table, include_extras=True)[name].__metadata__[-1]
    return meta.description or ""


def is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and value != [] and isinstance(value[0], dict))


def toml_repr(value: object, depth: int = 3) -> str:
    """A value as TOML would write it, cut where it is long, nested or huge."""
    if isinstance(value, str):
        return cut(json.dumps(value[:LONGEST], ensure_ascii=False))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):  # beyond some hundred digits Python may refuse to write decimals, never hex
        return cut(str(value) if value.bit_length() < 2000 else hex(value))
    if isinstance(value, list):
        items = [toml_repr(item, depth - 1) for item in value[:LONGEST]] if depth else ["..."]
        return cut(f"[{', '.join(items)}]")
    return "a table" if isinstance(value, dict) else str(value)


def inline(table: Mapping[str, object]) -> str:
    """A table as TOML would write it in one line, cut where it is long."""
    return cut(f"{{{', '.join(f'{cut(key)} = {toml_repr(value)}' for key, value in table.items())}}}")


def with_kind(value: object) -> str:
    """A value with the name of its TOML type, for where the type is the fault."""
    if is_table(value):
        return "a table" if isinstance(value, dict) else "an array of tables"
    kinds = {bool: "a boolean", int: "a whole number", float: "a float", str: "a string", list: "an array"}
    return f"{toml_repr(value)} ({kinds.get(type(value), 'a date or time')})"
