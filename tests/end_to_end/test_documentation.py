"""Pages run as they stand, are as long as a page may be, and become a gallery and notebooks."""

from __future__ import annotations

import ast
import inspect
import math
import os
import re
import sys
from enum import Enum
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from outputs import EXAMPLES, load, module_at
from scenes import chain, family, table

import casadi_skin
from casadi_skin.runs.program import main
from casadi_skin.runs.reading import parse_scene

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {path.stem: path for path in (*sorted(DOCS.glob("*.md")), DOCS.parent / "README.md")}
WITH_PROGRAMS = [name for name, path in PAGES.items() if "```python\n" in path.read_text(encoding="utf-8")]
NOTEBOOKS = ("my_chain", "my_lattice", "my_ode")
CLUSTERS = ("executorlib", "mpi4py", "dask_jobqueue")  # programs that import these need a cluster
REFERENCES = (  # tables and formulas to look things up in, partly generated
    "accuracy_and_speed", "boundary_speed", "examples", "paper_checked", "peers", "proofs", "python_reference",
    "scene_reference", "tradeoff",
)  # fmt: skip
MOST_WORDS = 1500
CHART = chain(4, 0.5) + family("first", 1.0) + "[stability]\n" + table(
    "map", gamma={"from": 0.2, "to": 0.5, "points": 2}, S={"from": 0.5, "to": 1.0, "points": 2},
    quantities=["stable", "max_abs_multiplier"],
) + '"g, mode" = [[-1.0, "first"], [1.0, "last"]]\n'  # fmt: skip


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page].read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def imported(program: str) -> list[str]:
    """Names that a program imports, each with its module before it."""
    found: list[str] = []
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def prepared(page: str) -> dict[str, Any]:
    """What a page says is there before its programs run: names of an example, or files in the current folder."""
    if page == "periodic_orbits_of_any_model":
        return vars(load("lyapunov_orbit"))
    if page == "fmu":
        load("foreign_fmu").made_elsewhere(Path())
    if page == "maps":
        Path("examples").mkdir()
        Path("examples/stability_chart.toml").write_text(CHART, encoding="utf-8")  # small: the true one takes a minute
    if page == "scenes_of_any_model":
        assert main(["run", str(EXAMPLES / "fput_modes.toml"), "--quiet"]) == 0
    return {}


@pytest.mark.slow
@pytest.mark.parametrize("page", [name for name in WITH_PROGRAMS if name not in NOTEBOOKS])
def test_the_programs_of_a_page_run_one_after_the_other(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    names = prepared(page)
    for program in blocks(page, "python"):
        if not any(name.startswith(CLUSTERS) for name in imported(program)):
            exec(compile(program, f"{page}.md", "exec"), names)
    plt.close("all")
    branch = names.get("branch")
    if page == "equilibria":
        fold, hopf, curve = (names[name] for name in ("fold", "hopf", "curve"))
        assert repr(fold).startswith("<fold at p = 0.105738978272 +- ")
        assert repr(hopf).startswith("<hopf at p = 0.13090004482 +- ")
        assert (hopf.frequency, hopf.coefficient) == pytest.approx((4.0077747, -0.3889545), abs=5e-8)
        assert curve.special_points[-1].kind == "cusp"
        x = 0.5 * (1.0 - math.sqrt(1.0 - 12.0 / 14.0))
        assert abs(fold.parameters["p"] - x * math.exp(-14.0 * x / 3.0) / (1.0 - x)) < 1e-16
    if page == "from_auto":
        assert [round(p.parameters["p1"], 7) for p in branch.special_points] == [0.105739, 0.0889318, 0.13090]  # type: ignore[union-attr]
    if page == "from_matcont":
        assert names["doubling"].parameters["alpha"] == pytest.approx(0.630302, abs=5e-7)
        assert names["doubling"].solution.period == pytest.approx(6.364071, abs=5e-7)
    if page == "from_solve_bvp":
        assert names["solution"]["k"] == pytest.approx(6.283185307179586, rel=1e-8)
    if page == "README":
        places, stable = [change.S for change in branch.changes], [orbit.floquet().stable for orbit in branch.orbits]  # type: ignore[union-attr]
        assert len(places) == 47  # counted by the recursion of the page on changes
        assert min(np.diff(places)) == pytest.approx(4.2e-4, rel=0.01)  # the narrowest window
        assert (len(stable), sum(np.diff(stable))) == (50, 11)  # of the table
        digits = branch.at(S=1.0).certify().Omega_digits  # type: ignore[union-attr]
        assert float(digits.split(" +/- ")[1].rstrip("]")) < 4e-21
        assert names["cycles"].special_points[-1].parameters["r"] == pytest.approx(13.92655741, abs=2e-6)  # published


def test_programs_and_scenes_of_pages_name_what_is_there() -> None:
    for page in WITH_PROGRAMS:
        for name in (name for program in blocks(page, "python") for name in imported(program)):
            if name.startswith("casadi_skin.") and name.count(".") == 1:
                assert hasattr(casadi_skin, name.partition(".")[2]), name
    for page in ("my_chain", "my_lattice"):
        (scene,) = blocks(page, "toml")
        parse_scene(scene, page)


def test_every_test_that_a_promise_names_is_there() -> None:
    tests = {path.name: path.read_text(encoding="utf-8") for path in Path(__file__).parents[1].rglob("*.py")}
    for page in ("promises", "promises_of_files"):
        file = ""
        for module, function in re.findall(r"(test_\w+\.py)|\b(test_\w+)`", PAGES[page].read_text(encoding="utf-8")):
            file = module or file
            assert file in tests, file
            assert not function or f"def {function}(" in tests[file], (file, function)


def test_pages_are_read_in_one_go_and_pictures_are_small() -> None:
    words = {name: len(path.read_text(encoding="utf-8").split()) for name, path in PAGES.items()}
    assert {name for name, count in words.items() if count >= MOST_WORDS} <= set(REFERENCES)
    sizes = {path.name: path.stat().st_size for path in (DOCS / "pictures").glob("*.png")}
    assert {name: size for name, size in sizes.items() if size >= 200_000} == {}


@pytest.mark.slow
@pytest.mark.parametrize("page", NOTEBOOKS)
def test_a_tutorial_is_a_notebook_that_ends_in_a_picture(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ipykernel")
    client = pytest.importorskip("nbclient")
    commands = tmp_path / "bin"  # casadi-skin, wherever it is installed
    commands.mkdir()
    (commands / "casadi-skin").write_text(f'#!/bin/sh\nexec {sys.executable} -m casadi_skin "$@"\n')
    (commands / "casadi-skin").chmod(0o755)
    monkeypatch.delenv("MPLBACKEND", raising=False)  # pictures go into the notebook
    monkeypatch.setenv("PATH", f"{commands}{os.pathsep}{os.environ['PATH']}")
    notebook = module_at(DOCS / "notebooks.py").notebook(page)
    assert not any("outputs" in cell and cell["outputs"] for cell in notebook.cells)
    client.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    if page == "my_chain":
        assert (tmp_path / "results" / "mine" / "family.csv").exists()


def test_the_gallery_leads_from_every_picture_to_a_section_that_has_it() -> None:
    text = module_at(DOCS / "gallery_page.py").gallery(DOCS)
    cells = re.findall(r"\[!\[.*?\]\((.*?)\)\n(.*?)\]\((.*?)\.md#(.*?)\)", text)
    assert len(cells) > 30
    for picture, head, page, _ in cells:
        assert (DOCS / picture).exists()
        section = (DOCS / f"{page}.md").read_text(encoding="utf-8").partition(f"# {head}\n")[2]
        assert picture in section


def test_the_reference_has_every_public_name_once() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in sorted(DOCS.glob("reference_*.md")))
    places = re.findall(r"^::: (\S+)", text, re.MULTILINE)
    assert len(places) == len(set(places))
    overview = PAGES["python_reference"].read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| \[`(\w+)`\]\[(\S+)\]", overview, re.MULTILINE))
    assert set(listed) == set(casadi_skin.__all__) - {"__version__"}
    assert set(listed.values()) <= set(places)
    assert overview == module_at(DOCS / "generate_public_names.py").page(overview), (
        "docs/python_reference.md is not in step: python docs/generate_public_names.py, and a line in CHANGELOG.md"
    )


def test_every_name_in_the_stub_is_public() -> None:
    """However its lines are formatted: the package reads them by a pattern, type checkers as Python."""
    stub = ast.parse(Path(casadi_skin.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    named = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert named == set(casadi_skin.__all__)
    assert all(hasattr(casadi_skin, name) for name in named)


OWN_PROGRAM = re.compile(r"casadi_skin\.(runs|results)\.[\w.]+|casadi_skin\.model\.arguments")


def test_examples_and_pages_import_public_names_alone() -> None:
    """But for the study of the paper: a program of its own made of what runs and pictures are made of."""
    programs = {path.name: path.read_text(encoding="utf-8") for path in EXAMPLES.rglob("*.py")}
    programs |= {f"{page}.md": "\n".join(blocks(page, "python")) for page in PAGES}
    papers = {path.name for path in (EXAMPLES / "paper").glob("*.py")}
    deep = {
        (name, module)
        for name, program in programs.items()
        for module in modules(program)
        if module.startswith("casadi_skin.") and not (name in papers and OWN_PROGRAM.fullmatch(module))
    }
    assert deep == set()
    used = {name for program in programs.values() for name in imported(program) if name.startswith("casadi_skin.")}
    assert {name for name in used if name.count(".") == 1} <= {f"casadi_skin.{name}" for name in casadi_skin.__all__}


# Names that other programs have for what is `model`, `guess`, `path`, `tolerance`, `progress` or `workers` here.
OTHERWISE = {
    "chain_or_model", "system", "ode", "initial", "initial_guess", "x0", "directory", "folder", "file", "filename",
    "target", "tol", "rtol", "atol", "eps", "callback", "verbose", "n_jobs", "jobs", "processes", "pool",
}  # fmt: skip
OTHER_TOLERANCES = {"find_equilibrium": 1e-10, "find_equilibria": 1e-10, "simulate": 1e-9, "evolve": 1e-11}
OTHER_TOLERANCES["simulate_orbit"] = OTHER_TOLERANCES["evolve"]  # why: "What is public" in python_reference.md


def test_one_argument_has_one_name_and_a_tolerance_one_value() -> None:
    made, tolerances = module_at(DOCS / "generate_public_names.py").MADE, {}  # no script makes results
    for name in casadi_skin.__all__:
        public = getattr(casadi_skin, name)
        if inspect.isclass(public) and issubclass(public, Enum | Exception):
            continue
        called = [] if inspect.isclass(public) and issubclass(public, made) else [public]
        called += [getattr(public, verb) for verb in dir(public) if verb[0] != "_" and inspect.isclass(public)]
        for function in filter(callable, called):
            arguments = inspect.signature(function).parameters
            assert not OTHERWISE & set(arguments), f"{name}, {function}"
            if function is public and "tolerance" in arguments:
                tolerances[name] = arguments["tolerance"].default
    assert {name: value for name, value in tolerances.items() if value != 1e-8} == OTHER_TOLERANCES


def modules(program: str) -> set[str]:
    """Modules that a program imports, or imports from."""
    nodes = list(ast.walk(ast.parse(program)))
    found = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return found | {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
