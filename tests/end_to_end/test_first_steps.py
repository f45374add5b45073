"""What a newcomer types first: help, a scene to start from, results as JSON, quiet, completion, the schema."""

from __future__ import annotations

import json
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
from drawing import blank_pictures
from outputs import EXAMPLES, read_rows
from scenes import Cli, chain, family

from casadi_skin.runs.program import _parser, main
from casadi_skin.runs.reading import parse_scene, scene_schema

CHAIN, FAMILY = chain(3), family(1, 0.1)
VERBS = tuple(_parser()._subparsers._group_actions[0].choices)  # type: ignore[union-attr]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_an_example_that_its_parser_takes(verb: str, cli: Cli) -> None:
    told = " ".join(cli("help", verb).out.split())
    assert told.startswith(f"usage: casadi-skin {verb}")
    example = told.rpartition("Example: ")[2].removeprefix('eval "$(').removesuffix(')"')
    words = example.split()
    assert words[:2] == ["casadi-skin", verb]
    assert _parser().parse_args(words[1:]).command == verb
    assert verb in cli("help").out


@pytest.mark.parametrize("kind", ["chain", "lattice", "model"])
def test_a_new_scene_is_commented_and_can_be_meant(kind: str, here: Path, cli: Cli) -> None:
    assert cli("new", kind).out.endswith(f"next: casadi-skin run {kind}.toml\n")
    text = (here / f"{kind}.toml").read_text(encoding="utf-8")
    assert text.count("#") > 10
    parse_scene(text)
    assert kind != "model" or cli("check", "model.toml", "--quiet") == (0, "", "")
    assert cli("new", kind).line == f"casadi-skin: new: {kind}.toml is there already; accepted: another --out\n"
    for out, reason in (("a.txt", "ends in .toml"), ("no/a.toml", "--out: given no/a.toml, in no directory")):
        assert reason in cli("new", kind, "--out", out).line


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["chain", "lattice", "model"])
def test_a_new_scene_runs(kind: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blank_pictures(monkeypatch)
    assert main(["new", kind, "--out", "mine.toml", "--quiet"]) == 0
    assert main(["run", "mine.toml", "--quiet"]) == 0
    table = "branch.csv" if kind == "model" else "family.csv"
    assert any(row["requested"] == "1" for row in read_rows(here / "results" / "mine" / table))


def results(cli: Cli, *words: str) -> Any:
    """What a command prints with --json, which is all that is on standard output."""
    return json.loads(cli(*words, "--json").out)


@pytest.fixture
def scene(here: Path) -> str:
    (here / "a.toml").write_text(CHAIN + FAMILY, encoding="utf-8")
    return "a.toml"


def test_results_as_json(scene: str, cli: Cli) -> None:
    assert len(results(cli, "spectrum", scene)["omega"]) == 3
    assert {"subject": "chain", "words": "N = 3, alpha = 1, gamma = 0.25, g = -1"} in results(cli, "check", scene)
    assert "not allowed with" in cli("run", scene, "--quiet", "--json").line


@pytest.mark.usefixtures("pictures")
def test_a_run_as_json_has_the_numbers_of_its_tables(scene: str, here: Path, cli: Cli) -> None:
    told = results(cli, "run", scene)
    rows = read_rows(here / "results" / "a" / "family.csv")
    assert (told["directory"], told["complete"], told["reasons"]) == ("results/a", True, [])
    assert "family.nc" in told["files"]
    family = told["tables"]["family"]
    assert [row["Omega"] for row in family] == [float(row["Omega"]) for row in rows]
    assert {type(family[0][name]) for name in ("mode", "S")} == {int, float}
    assert results(cli, "run", scene, "--resume") == told


@pytest.mark.slow
def test_a_study_is_quiet_or_prints_json(scene: str, cli: Cli) -> None:
    words = ["tradeoff", scene, "--quick", "--out", "out"]
    done = cli(*words, "--quiet")
    assert done.out == ""
    assert (done.status == 1) == bool(done.err)
    assert results(cli, *words, "--overwrite")["tables"]


def test_the_schema_has_no_null_and_is_written(here: Path, cli: Cli) -> None:
    printed = cli("schema").out
    assert printed == json.dumps(scene_schema(), indent=2) + "\n"
    assert "null" not in printed
    assert cli("schema", "--out", "scene.schema.json").status == 0
    assert (here / "scene.schema.json").read_text(encoding="utf-8") == printed


@pytest.mark.slow
def test_editors_take_every_example_by_the_schema_and_mark_a_wrong_key() -> None:
    from jsonschema import Draft202012Validator

    schema = Draft202012Validator(scene_schema())
    for path in EXAMPLES.glob("*.toml"):
        scene = tomllib.loads(path.read_text(encoding="utf-8"))
        assert not list(schema.iter_errors(scene)), path
        (fault,) = schema.iter_errors(scene | {"famly": {}})
        assert "famly" in fault.message


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_every_verb(shell: str, here: Path, cli: Cli) -> None:
    script = cli("completion", shell).out
    assert all(verb in script for verb in VERBS)
    if shell == "bash":
        (here / "completion").write_text(script, encoding="utf-8")
        complete = "COMP_WORDS=(casadi-skin ru); COMP_CWORD=1; _shtab_casadi_skin; echo ${COMPREPLY[@]}"
        done = subprocess.run(
            ["bash", "-c", f"source completion; {complete}"], capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == ["run"]
