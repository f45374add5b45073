"""Files without end, and numbers at the ends of doubles: each is refused, or ends, in a line."""

from __future__ import annotations

import os
import re
import resource
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scenes import Cli, chain, family, lattice, table

from casadi_skin import OdeModel, find_orbit, read_model, read_result, simulate
from casadi_skin.model.loading import LARGEST_FILE_BYTES
from casadi_skin.results.dataset import check_whole
from casadi_skin.runs import cost
from casadi_skin.runs import map as map_module
from casadi_skin.runs.binding import bound
from casadi_skin.runs.map import map_lines
from casadi_skin.runs.map_cell import Computer
from casadi_skin.runs.map_grid import MOST_TRIED, axes_of
from casadi_skin.runs.plan import plan_lines
from casadi_skin.runs.program import main
from casadi_skin.runs.reading import parse_scene, read_scene
from casadi_skin.runs.rules import SceneError
from casadi_skin.solve.watch import check_time_limit

TEN_GIGABYTES = 10 * 2**30
CHAIN = "[chain]\nsites = 3\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n[family]\nmode = 1\namplitude_max = 0.5\n[map]\n"


@pytest.mark.parametrize("read", [read_scene, read_model, read_result])
@pytest.mark.parametrize("kind", ["device", "pipe", "long"])
def test_files_without_end_are_refused(kind: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "file"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.touch()
        os.truncate(path, TEN_GIGABYTES)
    with pytest.raises(ValueError, match=f"^{path}: ") as caught:
        read(path)
    words = {"long": f"longer than {LARGEST_FILE_BYTES} bytes"}.get(kind, "no regular file")
    if read is read_result:
        words = {"long": "no record of a journal at byte 0"}.get(kind, "no such file")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_long_table_is_looked_at_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "family.csv"
    path.touch()
    os.truncate(path, TEN_GIGABYTES)
    with pytest.raises(ValueError, match="its last row is cut off"):
        check_whole(path)
    with path.open("ab") as file:
        file.write(b"\n")
    check_whole(path)


def van_der_pol() -> OdeModel:
    x, v, mu = (ca.SX.sym(name) for name in ("x", "v", "mu"))
    return OdeModel("vdp", ca.vertcat(x, v), ca.vertcat(v, mu * (1 - x**2) * v - x), mu, nominal=(1.0,))


def test_a_state_that_the_model_cannot_take_ends_a_simulation() -> None:
    """Scipy's steps have the length NaN then, and none of them ends."""
    words = r"x = 1e\+200 is its largest component there, and CVODES returned CV_FIRST_RHSFUNC_ERR"
    with pytest.raises(ArithmeticError, match=words):
        simulate(van_der_pol(), [1e200, 0.0], [0.0, 1.0])


@pytest.mark.parametrize("mu", [1e120, 1e200])
def test_a_huge_parameter_ends_in_a_line(mu: float) -> None:
    def circle(t: float) -> list[float]:
        return [2.0 * np.cos(t), -2.0 * np.sin(t)]

    with pytest.raises(ArithmeticError, match=r"^vdp: no solution near the guess: [^\n]*$"):
        find_orbit(van_der_pol(), circle, 2.0 * np.pi, parameters={"mu": mu})


def test_the_cost_of_cells_that_take_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a minute or more for S to 1e100 with stability."""

    def endless(*_: object) -> None:
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            check_time_limit("a step")

    monkeypatch.setattr(map_module, "MEASURED_SECONDS", 0.2)
    monkeypatch.setattr(Computer, "_rows", endless)
    path = tmp_path / "scene.toml"
    scene = parse_scene(CHAIN + "S = { from = 0.1, to = 1e100, points = 10 }\n", str(path))
    words = dict(map_lines(scene, bound(scene, path), path))["cost of cells"]
    assert re.fullmatch(
        r"more than 0.02\d* s for one \(measured on S = 0.1, given up after 0.2\d* s\); more than .*", words
    )


def test_a_map_of_many_orbits_is_planned_from_few(tmp_path: Path) -> None:
    text = CHAIN + "S = { from = 0.01, to = 0.5, points = 20000 }\ngamma = { from = 0, to = 0.9, points = 100 }\n"
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = read_scene(path)
    words = dict(map_lines(scene, bound(scene, path), path))
    assert words["cells"] == "20000 S x 100 gamma = 2000000, orbits of 100 families"
    assert "it failed" not in words["cost of cells"]


def test_a_long_list_is_checked_in_little_time() -> None:
    values = [1.0 + k / 2**20 for k in range(2**16)]
    assert len(axes_of(parse_scene(f"{CHAIN}alpha = {values}\n"))[0].values) == 2**16 > MOST_TRIED
    with pytest.raises(SceneError, match=r"1\.5 as item 65537 again"):
        axes_of(parse_scene(f"{CHAIN}alpha = {[1.5, *values[1:], 1.5]}\n"))


def test_a_design_on_many_sites_is_planned_without_an_orbit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chain, path = CHAIN.partition("[family]")[0], tmp_path / "scene.toml"
    design = '[design]\nquantity = "Omega_slope"\nmode = 1\nS = 0.1\nover = ["gamma"]\nbounds = { gamma = [0, 0.5] }\n'
    monkeypatch.setattr("casadi_skin.search.design_problem.follow_family", lambda *_, **__: pytest.fail("solved"))
    path.write_text(chain.replace("= 3", "= 30000") + design)
    words = dict(plan_lines(bound(read_scene(path), path), measure=False))
    assert words["design"] == "smallest Omega_slope of the orbits at S = 0.1"


RING = """
import casadi as ca
from casadi_skin import OdeModel

x, v = ca.SX.sym("x", {n}), ca.SX.sym("v", {n})
ring = OdeModel("ring", [*x.elements(), *v.elements()], ca.vertcat(v, (1 - x**2) * v - x), ca.SX(0, 1))
"""


def test_an_orbit_says_what_it_needs_and_is_refused_where_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('[model]\nfile = "ring.py"\nname = "ring"\n[orbit]\nstart = { x_0 = 0.1 }\nperiod = 6.66\n')
    (tmp_path / "ring.py").write_text(RING.format(n=250))
    request = bound(read_scene(scene), scene)
    words = dict(plan_lines(request, measure=False))
    assert words["unknowns"].startswith("42500 state values and period on 12 gauss intervals of degree 6 at the start")
    assert re.match(r"1\d s and 3.\d GB of the [\d.e+]+ GB there for the first solution", words["expected cost"])
    monkeypatch.setattr(cost, "available_memory", lambda: 1e9)
    out = tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(r"casadi-skin: \S+: \[orbit\]: needs about 3.\d GB of memory [^\n]* --beyond-memory\n", line)
    assert not out.exists()


def test_more_memory_than_there_is_may_be_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('[model]\nfile = "ring.py"\nname = "ring"\n[orbit]\nstart = [2, 0]\nperiod = 6.66\n')
    (tmp_path / "ring.py").write_text(RING.format(n=1))
    monkeypatch.setattr(cost, "available_memory", lambda: 1e6)
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet", "--beyond-memory"]) == 0


PLANE = lattice([40, 40], "y + g*y^3", ([1, 0], [0, 1]), {"g": -1.0}, force="d") + family(1, 1.0)
LARGE = {
    "family": ("run", PLANE, "0.36 GB", "family"),
    "multipliers": ("run", PLANE + "[stability]\n", "1.2 GB", "family"),
    "design": (
        "run",
        chain(2000) + table("design", quantity="Omega", mode="last", over=["S"], bounds={"S": [0.1, 1]}),
        "0.34 GB",
        "design",
    ),
    "map": ("map", PLANE + "[map]\ng = [-1.0, 1.0]\n", "1.1 GB", "family"),
}


@pytest.mark.parametrize(
    "name", ["design", *(pytest.param(name, marks=pytest.mark.slow) for name in LARGE if name != "design")]
)
def test_what_needs_more_memory_than_there_is_is_refused_before_it_starts(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    command, text, need, asked = LARGE[name]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = parse_scene(text, str(path))
    assert "GB" in dict(plan_lines(bound(scene, path), measure=False))["memory"]
    monkeypatch.setattr(cost, "available_memory", lambda: 1e8)
    words = ("--workers", "3") if command == "map" else ()
    line = cli(command, path, "--out", tmp_path / "out", "--quiet", *words).line
    assert line.startswith(f"casadi-skin: {path}: [{asked}]: needs about {need} of memory (within a factor of 2)")
    assert line.endswith("or the option --beyond-memory\n")
    assert not (tmp_path / "out").exists()


def test_memory_that_a_container_or_ulimit_leaves_is_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    free = cost.available_memory()
    own, limits = tmp_path / "own", tmp_path / "job" / "step"
    own.write_text("0::/job/step\n")
    limits.mkdir(parents=True)
    monkeypatch.setattr(cost, "OWN_GROUPS", own)
    monkeypatch.setattr(cost, "GROUPS", tmp_path)
    (limits / "memory.max").write_text("max\n")
    assert cost.available_memory() == pytest.approx(free, rel=0.5)
    for name, text in (("max", "5000000"), ("current", "4000000"), ("stat", "anon 3\ninactive_file 250000\n")):
        (limits.parent / f"memory.{name}").write_text(text)
    assert cost.available_memory() == 1.25e6
    own.write_text("9:memory:/job\n")
    (tmp_path / "memory" / "job").mkdir(parents=True)
    (tmp_path / "memory" / "memory.limit_in_bytes").write_text("7000000")
    (tmp_path / "memory" / "memory.usage_in_bytes").write_text("1000000")
    assert cost.available_memory() == pytest.approx(free, rel=0.5)
    (tmp_path / "memory" / "memory.stat").write_text("cache 1\n")
    assert cost.available_memory() == 6e6
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1000, 1000))
    assert cost.available_memory() < 0
