"""What messages about arguments are made of."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from casadi_skin import (
    Chain,
    Solution,
    build_c,
    export_c,
    export_fmu,
    find_equilibria,
    read_map,
    run_map,
    search_orbit,
    smallest_kick,
)
from casadi_skin.model.arguments import LONGEST_VALUE_TEXT, check_name, cut, short_repr

NAMES = ("Omega", "S", "gamma", "participation")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("gama", "free: given 'gama'; did you mean gamma? accepted: Omega, S, gamma, participation"),
        ("period", "free: given 'period'; accepted: Omega, S, gamma, participation"),
        (["gamma"], "free: given ['gamma']; did you mean gamma? accepted: Omega, S, gamma, participation"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest_one(given: object, words: str) -> None:
    with pytest.raises(ValueError, match="given") as refused:
        check_name("free", given, NAMES)
    assert str(refused.value) == words


def test_long_values_are_one_line_of_so_many_characters() -> None:
    assert cut("k" * LONGEST_VALUE_TEXT) == "k" * LONGEST_VALUE_TEXT
    assert cut("k" * (LONGEST_VALUE_TEXT + 1)) == "k" * (LONGEST_VALUE_TEXT - 3) + "..."
    assert short_repr("a\nb" * 50) == "'" + "a\\nb" * 14 + "..."
    assert short_repr(10**5000).startswith("0x")
    assert len(short_repr(10**5000)) == LONGEST_VALUE_TEXT


def test_older_names_of_arguments_work_and_the_warning_names_the_new_one(tmp_path: Path) -> None:
    chain, export = Chain(2, 1.0, 0.25, 1.0), _untyped(export_c)
    with pytest.warns(DeprecationWarning, match="export_c: the argument directory is called path; directory is taken"):
        written = export(chain, directory=tmp_path / "c", what=["rhs"])
    again = export(chain, tmp_path / "again", ["rhs"])
    assert [path.read_text() for path in sorted(written.iterdir())] == [p.read_text() for p in sorted(again.iterdir())]
    calls: list[tuple[Callable[..., Any], dict[str, Any], str, str]] = [
        (read_map, {"directory": 3}, "path", "path: given 3"),
        (build_c, {"directory": 3}, "path", "path: given 3"),
        (search_orbit, {"chain_or_model": 3, "free": ["mu"]}, "model", "model: given 3"),
        (run_map, {"out": 3, "scene": tmp_path / "a.toml"}, "path", "path: given 3"),
        (smallest_kick, {"at": 3, "orbit": 3, "time": 1.0}, "sites", "orbit: given 3"),
        (find_equilibria, {"lower": 3, "model": chain}, "bounds", "bounds: given 3"),
        (partial(Solution.floquet, None), {"by": "cvodes"}, "flow", "no attribute '_computed'"),
        (export_fmu, {"what": 3, "path": tmp_path / "a.fmu"}, "source", "source: given 3"),
    ]
    for call, given, name, words in calls:
        told = pytest.warns(DeprecationWarning, match=f"is called {name}; ")
        with told as warned, pytest.raises((TypeError, AttributeError), match=words):
            call(**given)
        assert [warning.filename for warning in warned] == [__file__]  # the place of the caller
    told = pytest.warns(DeprecationWarning, match="is called path; ")
    with told, pytest.raises(TypeError, match="multiple values for argument 'path'"):
        _untyped(read_map)(tmp_path, directory=tmp_path)


def _untyped(function: Callable[..., Any]) -> Callable[..., Any]:
    return function
