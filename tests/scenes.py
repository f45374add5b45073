"""Scenes of tests, from plain values to TOML, and runs of them in a folder of the test."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from apart import Ended
from outputs import read_rows

Cli = Callable[..., Ended]


def toml(value: Any) -> str:
    """A value in TOML; tables inline, so that any value can stand at any place."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value).lower()  # True, 3, 1e-08, nan


def table(name: str, /, **keys: Any) -> str:
    """A table of a scene."""
    return f"[{name}]\n" + "".join(f"{key} = {toml(value)}\n" for key, value in keys.items())


def chain(sites: float = 6, alpha: float = 1.0, gamma: float = 0.25, g: float = -1.0) -> str:
    return table("chain", sites=sites, alpha=alpha, gamma=gamma, g=g)


def lattice(cells: Any, onsite: str, offsets: Any = ([1],), parameters: Any = (), **bond: Any) -> str:
    """Sites called a, one a cell, with a bond for each offset."""
    bonds = [{"from": "a", "to": "a", "offset": offset, **bond} for offset in offsets]
    return table(
        "lattice", cells=cells, parameters=dict(parameters), site=[{"name": "a", "onsite": onsite}], bond=bonds
    )


def family(mode: Any = 1, amplitude_max: float = 1.0, **keys: Any) -> str:
    return table("family", mode=mode, amplitude_max=amplitude_max, **keys)


def column(path: Path, name: str, **where: str) -> np.ndarray:
    """Numbers of a column of a CSV file, in the rows that have these words in other columns."""
    rows = [row for row in read_rows(path) if all(row[key] == word for key, word in where.items())]
    return np.array([float(row[name] or "nan") for row in rows])


class Runs:
    """Runs scenes in a folder; results are in its `out`."""

    def __init__(self, folder: Path, cli: Cli) -> None:
        self.folder, self.cli, self.out = folder, cli, folder / "out"
        self.scene = folder / "scene.toml"

    def __call__(self, text: str | Path = "", *words: str, status: int = 0, command: str = "run") -> Ended:
        """Run a text, the file of a scene, or the scene of before once more; the exit status has to be this one."""
        if isinstance(text, str) and text:
            self.scene.write_text(text, encoding="utf-8")
        scene = text if isinstance(text, Path) else self.scene
        done = self.cli(command, scene, *(["--out", self.out] if command == "run" else []), *words)
        assert done.status == status, done.err
        assert "Traceback" not in done.err
        return done

    def rows(self, name: str) -> list[dict[str, str]]:
        """Rows of a table of results."""
        return read_rows(self.out / f"{name}.csv")

    def columns(self, name: str, *columns: str, **where: str) -> list[np.ndarray]:
        """Columns of a table of results; see `column`."""
        return [column(self.out / f"{name}.csv", each, **where) for each in columns]

    @property
    def files(self) -> set[str]:
        """Names of the files of results."""
        return {path.name for path in self.out.iterdir()}


@pytest.fixture
def run(tmp_path: Path, cli: Cli) -> Runs:
    """Runs of scenes in the folder of the test."""
    return Runs(tmp_path, cli)


def written(folder: Path, models: str, name: str, rest: str = "") -> str:
    """A scene of a model by name in a Python file, which is written."""
    (folder / "model.py").write_text(models, encoding="utf-8")
    return f'[model]\nfile = "model.py"\nname = "{name}"\n{rest}'
