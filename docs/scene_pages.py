"""MkDocs hook: writes the scene reference from the schema of a scene and the table of quantities of results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from casadi_skin.results import quantities as known
from casadi_skin.runs.reading import scene_schema

MARK = "<!-- tables from the schema -->"
SCHEMA_MARK = "<!-- the schema -->"
OF_FAMILIES = (*known.FAMILY_QUANTITIES, *known.FAMILY_STABILITY, *known.FAMILY_ERRORS, *known.FAMILY_PROOFS)
COLUMNS = {  # quantities of a table of a run, by the mark where they are listed
    "<!-- columns of family.csv -->": (*OF_FAMILIES, known.PROVED_STABILITY),
    "<!-- columns of branch.csv -->": (*known.HEAD, known.IS_FOLD, known.PERIOD, *known.ERRORS, *known.STABILITY),
    "<!-- columns of equilibria -->": (*known.HEAD, known.SPECIAL, *known.AT_REST),
}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put the generated tables in place of the marks."""
    if MARK not in markdown:
        return markdown
    schema = scene_schema()
    text = json.dumps(schema, indent=2)
    for mark, quantities in COLUMNS.items():
        markdown = markdown.replace(mark, column_table(quantities))
    return markdown.replace(MARK, scene_tables(schema)).replace(SCHEMA_MARK, f"```json\n{text}\n```")


def column_table(quantities: Sequence[known.Quantity]) -> str:
    """A row for each column of a table in CSV."""
    shown = [q for q in quantities if not q.dimensions and q.where in (known.CSV, known.BOTH)]
    rows = [f"| `{q.name}` | {q.meaning} |" for q in shown]
    return "\n".join(["| column | what it is |", "| --- | --- |", *rows])


def scene_tables(schema: dict[str, Any]) -> str:
    """A section for each table of a scene, a row for each key."""
    definitions = schema["$defs"]
    scene = definitions["Scene"]
    keys = {name: value for name, value in scene["properties"].items() if _table(value) is None}
    models = [f"`[{name}]`" for choice in scene["anyOf"] for name in choice["required"]]
    parts = ["## Outside of any table", _rows(keys, [])]
    for name, value in scene["properties"].items():
        table = _table(value)
        if table is None:
            continue
        definition = definitions[table]
        needed = (
            f"Required: one of {', '.join(models[:-1])} and {models[-1]}." if f"`[{name}]`" in models else "Optional."
        )
        parts += [f"## `[{name}]`", f"{_first_line(definition['description'])} {needed}"]
        if definition["properties"]:
            parts.append(_rows(definition["properties"], definition["required"]))
        for key, inner in definition["properties"].items():
            item = definitions.get(_table(inner.get("items", {})) or "")
            if item is not None:
                parts += [f"## `[[{name}.{key}]]`", f"{_first_line(item['description'])} Part of `[{name}]`."]
                parts.append(_rows(item["properties"], item["required"]))
    return "\n\n".join(parts)


def _table(value: dict[str, Any]) -> str | None:
    """The definition that a key of the scene refers to, if it is a table."""
    for choice in (value, *value.get("anyOf", [])):
        if "$ref" in choice:
            return str(choice["$ref"]).rpartition("/")[2]
    return None


def _rows(properties: dict[str, Any], required: list[str]) -> str:
    lines = ["| key | what it is | accepted | default |", "| --- | --- | --- | --- |"]
    for name, value in properties.items():
        cells = [f"`{name}`", value.get("title", ""), value.get("description", ""), _default(name, value, required)]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def _default(name: str, value: dict[str, Any], required: list[str]) -> str:
    if name in required:
        return "required"
    default = value.get("default")
    return "not set" if default is None else f"`{json.dumps(default)}`"


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0]
