"""Maps: what [map] accepts, which cells are computed, what is kept of them."""

from __future__ import annotations

import json
import os
import tracemalloc
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from maps import EQUILIBRIUM, TINY, Now, files, tasks, write
from matplotlib.collections import QuadMesh
from outputs import drawn, read_rows
from scenes import Cli, chain, family, lattice, table
from scipy.io import netcdf_file

from casadi_skin import Chain, follow_family, read_map, run_map
from casadi_skin.results.figures.map import COLOUR_MAP, MapAxis, Panel, map_figure
from casadi_skin.runs.binding import bind
from casadi_skin.runs.map_cell import FAMILY_SUFFIX, Computer, Result, Row, asked, known_names
from casadi_skin.runs.map_grid import UNKNOWN_LABEL, Axis, Grid, needed, plain, scene_at
from casadi_skin.runs.map_lines import Entry, boundaries, checked, lowest
from casadi_skin.runs.map_result import UNKNOWN as NOT_COMPUTED
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.program import main
from casadi_skin.runs.reading import parse_scene

BASE, _, AXES = TINY.partition("[map]\n")
REFUSED = {
    "gama = { from = 0.0, to = 0.5, points = 3 }": "[map] gama: neither a parameter of the scene nor an option; did",
    "gamma = 3": "[map] gamma: given 3 (a whole number); accepted: a table { from, to, points }, or a list of values",
    "gamma = { from = 0.0, points = 3 }": "[map] gamma, to: missing; accepted: a finite number, not the first one",
    "gamma = { from = 0.0, to = 0.5, point = 3 }": "[map] gamma, point: unknown key; did you mean 'points'?",
    "gamma = { from = 0.0, to = 0.5, points = 1 }": "[map] gamma, points: given 1; accepted: a whole number >= 2",
    "gamma = { from = 0.2, to = 0.2, points = 3 }": "[map] gamma, to: given 0.2, where it starts; accepted: another",
    "gamma = { from = 0.0, to = 1.2, points = 3 }": "[map] gamma: given 1.2, which the scene refuses: [chain] gamma",
    "gamma = { from = 0.0, to = 0.5, points = 3, log = true }": "[map] gamma, log: given true from 0.0 to 0.5;",
    "gamma = [0.1, 0.1]": "[map] gamma: given 0.1 as item 2 again; accepted: each value once",
    "gamma = []": "[map] gamma: given []; accepted: a list of one or more finite numbers or names",
    "sites = [2]\nN = [3]": "[map] N: given the same parameter as sites; accepted: each parameter once",
    '"family.modes" = [1]': "[map] family.modes: given 1, which the scene refuses: [family] modes: unknown key",
    '"nowhere.key" = [1]': "[map] nowhere.key: given no key of the scene; accepted: TABLE.KEY",
    "cell_limit = 0.0\ngamma = [0.1]": "[map] cell_limit: given 0.0; accepted: a finite number > 0",
    'gamma = [0.1]\nquantities = ["Omga"]': "[map] quantities: given 'Omga'; did you mean Omega?",
    'gamma = [0.1]\nwatch = ["stabel"]': "[map] watch: given 'stabel'; did you mean stable?",
    "along = 'gamma'\ngamma = { from = 0.1, to = 0.2, points = 3 }": '[map] along: given "gamma"; accepted: a range of',
    "gamma = [0.1]\nboundary = true": "[map] boundary: given without two ranges; accepted: beside two ranges",
    "gamma = [0.1]\n[map.axes]\ngamma = [0.2]": "[map] gamma: given again in its axes; accepted: each parameter once",
    "gamma = { from = 0.1, to = 0.2, points = 3, resolution = 1e-300 }": "[map]: given more than 10000000 cells at its",
    "gamma = { from = 0.1, to = 0.2, points = 100000 }\nN = { from = 2, to = 102, points = 101 }": "[map]: given more",
    "g = { from = -1.7e308, to = 1.7e308, points = 3 }": "[map] g, to: given 1.7e+308, farther from -1.7e+308 than",
    'gamma = [0.1]\n"chain.gamma" = [0.2]': "[map] chain.gamma: given the same parameter as gamma; accepted: each",
    "gamma = [0.1]\nwatch = []": "[map] watch: ",
    "gamma = [0.1]\nS = [0.1, 0.1]": "[map] S: given 0.1 as item 2 again; accepted: each value once",
    "": "[map]: no axis; accepted: a parameter of the scene with a table { from, to, points }, or a list of values",
    "boundary = true\n" + AXES: "[map] boundary: given without S or [stability]; accepted: beside [family] a",
}
SEVERAL = (
    BASE.replace("mode = 1", "mode = [1, 2]") + "[stability]\n[map]\nboundary = true\n" + AXES.partition("mode")[0]
)
TEXTS = {f"{BASE}[map]\n{given}\n": words for given, words in REFUSED.items()} | {
    SEVERAL: "[map] boundary: given with several families in a cell; accepted: one, or an axis mode"
}


@pytest.mark.parametrize("text", TEXTS)
def test_a_bad_map_is_refused_in_one_line(text: str, tmp_path: Path, cli: Cli) -> None:
    scene, out = write(tmp_path, text), tmp_path / "out"
    assert cli("map", scene, "--out", out).line.startswith(f"casadi-skin: {scene}: {TEXTS[text]}")
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--part 1/3 --overwrite", "map: --overwrite: given beside part, whose directory holds other shares;"),
        ("--scheduler nonsense", "map: --scheduler: given 'nonsense'; accepted: an address, such as tcp://host:8786"),
        ("--part 4/3", "map: --part: given 4/3; accepted: K/N with 1 <= K <= N <= 32767, such as 3/20"),
        ("--part x", "map: --part: given 'x'; accepted: K/N with 1 <= K <= N <= 32767, such as 3/20"),
        ("--workers 0", "map: --workers: given 0; accepted: a whole number from 1 to 256"),
    ],
)
def test_bad_words_are_refused(words: str, told: str, tmp_path: Path, cli: Cli) -> None:
    assert cli("map", write(tmp_path, TINY), *words.split()).line.startswith(f"casadi-skin: {told}")


def test_values_of_a_refined_axis_hold_those_of_the_coarse_one(tmp_path: Path) -> None:
    def axis(words: str) -> np.ndarray:
        (tmp_path / "scene.toml").write_text(f"{BASE}[map]\ngamma = {{ {words} }}", encoding="utf-8")
        return read_map(tmp_path).axes["gamma"]

    coarse = axis("from = 0.1, to = 0.7, points = 4")
    assert axis("from = 0.1, to = 0.7, points = 4, resolution = 0.06")[::4].tolist() == coarse.tolist()
    ratios = axis("from = 0.01, to = 0.8, points = 5, log = true")
    assert ratios[1:] / ratios[:-1] == pytest.approx(80**0.25)
    assert axis("from = 0, to = 1, points = 2").dtype.kind == "i"


@pytest.mark.parametrize("radius", [0.05, 0.3, 0.49])
def test_a_boundary_is_sharp_for_a_tenth_of_the_cells(radius: float) -> None:
    """Every two neighbours of the finest grid that differ are computed; the truth is a circle."""
    values = tuple(np.linspace(0.0, 1.0, 257).tolist())
    grid = Grid((Axis("x", (("a", "x"),), values, 16, True), Axis("y", (("a", "y"),), values, 16, True)))
    x, y = np.meshgrid(values, values, indexing="ij")
    truth = ((x - 0.45) ** 2 + (y - 0.5) ** 2 < radius**2).astype(np.int32)
    labels = np.full(grid.shape, UNKNOWN_LABEL, dtype=np.int32)
    while (cells := needed(grid, labels)).size:
        assert np.all(labels.flat[cells] == UNKNOWN_LABEL)
        labels.flat[cells] = truth.flat[cells]
    known = labels != UNKNOWN_LABEL
    assert np.mean(known) < 0.1
    for inside, computed in ((truth, known), (truth.T, known.T)):
        differ = np.diff(inside, axis=0) != 0
        assert np.all(computed[:-1][differ])
        assert np.all(computed[1:][differ])


def test_a_map_is_that_of_its_families(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write(tmp_path, TINY.replace("points = 3", "points = 2").replace("[1, 2]", "[2]")), tmp_path / "out"
    words = ["map", str(scene), "--out", str(out), "--no-pictures"]
    assert main(words) == 0
    branch = follow_family(Chain(2, 1.0, 0.3, -1.0), 2, 0.1, at=(0.05,), tolerance=1e-4)
    truth = [branch.at(S=S).Omega for S in (0.05, 0.1)]
    rows = read_rows(out / "map.csv")
    assert len(rows) == 4
    assert [float(row["Omega"]) for row in rows if float(row["gamma"]) == 0.3] == truth
    with netcdf_file(out / "map.nc", mmap=False) as found:
        variable = found.variables["Omega"]
        assert (variable.dimensions, variable.long_name, variable.units) == (("gamma", "S", "mode"), b"frequency", b"1")
        assert variable[1, :, 0].tolist() == truth
    assert main(words) == 2
    capsys.readouterr()
    assert main([*words, "--resume", "--json"]) == 0
    assert len(tasks(out / "journal.msgpack")) == 2
    printed = json.loads(capsys.readouterr().out)
    assert (printed["complete"], printed["reasons"]) == (True, [])
    assert [row["Omega"] for row in printed["tables"]["map"] if row["gamma"] == 0.3] == truth
    read = read_map(out)
    assert (read.complete, read.status.tolist()) == (True, [[[1], [1]], [[1], [1]]])
    assert read["Omega"][1, :, 0].tolist() == truth
    assert read.to_dataframe()["Omega"].tolist() == read["Omega"].ravel().tolist()
    in_one_file(read, tmp_path)
    axes = read.plot("Omega")
    (mesh,) = [c for c in axes.collections if isinstance(c, QuadMesh)]
    assert np.asarray(mesh.get_array()).T.tolist() == read["Omega"][:, :, 0].tolist()
    with pytest.raises(ValueError, match="at: mode: given 1; accepted: 2"):
        read.plot("Omega", axes, {"mode": 1})
    with pytest.raises(ValueError, match=r"quantity: given 'Omga'; did you mean Omega\?"):
        read.plot("Omga")


def in_one_file(found: Map, folder: Path) -> None:
    """A map in one file is read with the same bits, and shown in a page."""
    path = found.save(folder / "chart.map")
    again = read_map(path)
    assert again.save(folder / "again.map").read_bytes() == path.read_bytes()
    assert again["Omega"].tobytes() == found["Omega"].tobytes()
    assert (repr(again), again.names, again.complete) == (repr(found), found.names, True)
    assert "<table><caption>Map" in again._repr_html_()
    assert "data:image/png;base64," in again._repr_html_()
    assert main(["explore", str(path), "--quiet"]) == 0
    assert '"name":"Omega"' in (folder / "chart.html").read_text(encoding="utf-8")
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    (folder / "damaged.map").write_bytes(data)
    for name, words in (("damaged.map", "damaged"), ("chart.html", "cannot be read as a map in one file")):
        with pytest.raises(ValueError, match=words) as error:
            read_map(folder / name)
        assert str(folder / name) in str(error.value)
    with pytest.raises(ValueError, match="which is a directory; accepted: the path of a file"):
        found.save(folder)


def kept(folder: Path, text: str, told: list[str]) -> Map:
    """A map whose cells have their numbers for Omega, where its journal has none yet."""
    folder.mkdir(exist_ok=True)
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    scene = parse_scene(text)
    with Map(folder, Grid.of(scene), scene, "journal.msgpack", told.append) as found:
        for task in found.grid.tasks(found.grid.coarsest) if not found.known and not told else ():
            found.add(task, 1, Result(tuple(Row({"Omega": float(cell)}) for cell in task.cells), seconds=1.0))
    return found


def test_a_journal_of_another_scene_or_with_damage_is_not_taken_for_results(tmp_path: Path) -> None:
    """Cells of another scene, a flipped bit and a cut: none is taken silently, and what is whole is kept."""
    told: list[str] = []
    assert kept(tmp_path / "one", TINY, told).complete
    journal = tmp_path / "one" / "journal.msgpack"
    whole = journal.read_bytes()
    for name, text in (("other", TINY.replace("0.25", "0.24")), ("titled", f'title = "another"\n{TINY}')):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.toml").write_text(text, encoding="utf-8")
        (tmp_path / name / "journal.msgpack").write_bytes(whole)
    with pytest.raises(ValueError, match=r"journal.msgpack: is the journal of another scene; accepted:"):
        read_map(tmp_path / "other")
    assert read_map(tmp_path / "titled").complete
    flipped = whole[: len(whole) // 2] + bytes([whole[len(whole) // 2] ^ 1]) + whole[len(whole) // 2 + 1 :]
    for data, reason in ((flipped, "a damaged record"), (whole[:-1], "a record that is cut off")):
        journal.write_bytes(data)
        found = kept(tmp_path / "one", TINY, told)
        assert 0 < np.sum(found.status == 1) < found.status.size
        (words,) = told
        assert words.startswith(f"{journal}: {reason} at byte ")
        assert words.endswith("; what follows it is dropped and computed again")
        assert whole.startswith(journal.read_bytes())
        told.clear()


def test_a_map_that_is_none_is_not_read(tmp_path: Path) -> None:
    for text, told in (("", "holds no scene.toml"), (BASE, "its scene.toml has no .map."), ("[", "scene.toml: ")):
        if text:
            (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=told) as caught:
            read_map(tmp_path)
        assert "\n" not in str(caught.value)
    (tmp_path / "scene.toml").write_text(TINY, encoding="utf-8")
    read = read_map(tmp_path)  # one that was begun, without a cell
    assert (read.complete, read.names, np.any(read.status)) == (False, [], False)


@pytest.mark.slow
def test_a_plan_tells_cells_and_cost_and_xarray_opens_the_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write(tmp_path, TINY)
    assert main(["check", str(scene)]) == 0
    plan = capsys.readouterr().out
    assert "3 gamma x 2 S x 2 mode = 12, orbits of 6 families" in plan
    assert "for one (measured on gamma = 0.2, S = 0.05, mode = 1); " in plan
    found = run_map(scene, tmp_path / "out", quiet=True)
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(tmp_path / "out" / "map.nc") as opened:
        assert dict(opened.sizes)["gamma"] == 3
        assert opened["Omega"].sel(S=0.1, mode=2).values.tolist() == found["Omega"][:, 1, 1].tolist()
        assert bytes(opened["end"].values[0, 0, 0]).strip() == b"reached"
    assert found.to_xarray()["Omega"].equals(xarray.DataArray(found["Omega"], found.axes, found.axes))
    assert drawn(tmp_path / "out" / "map_Omega.png")


ORBIT = (
    chain(1, gamma=0.0, g=1.0)
    + table("orbit", start=[0.3, 0.0], period=4.0, symmetric=True, select={"y_1": 0.3})
    + "[map]\nalpha = [1.0]\n"
)
DESIGN = BASE.replace("[family]\nmode = 1\namplitude_max = 0.1\n", "") + (
    '[design]\nquantity = "Omega"\nover = ["S"]\nbounds = { S = [0.1, 0.2] }\nstarts = 1\n[map]\nalpha = [1.0]\n'
)
OF_EACH = {
    "family": BASE + "[stability]\n[map]\nmode = [1]\n",
    "orbit": ORBIT,
    "design": DESIGN,
    "equilibrium": EQUILIBRIUM + '[continuation]\nparameter = "p"\nto = 1.0\n[map]\np = [0.2]\n',
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", OF_EACH)
def test_names_of_quantities_are_known_before_a_cell_is_computed(kind: str, tmp_path: Path) -> None:
    path, scene = write(tmp_path, OF_EACH[kind]), parse_scene(OF_EACH[kind])
    grid = Grid.of(scene)
    result = Computer(plain(scene), str(path))(next(grid.tasks(grid.coarsest)))
    assert result.rows, result.reason
    known = known_names(bind(scene, path))
    assert [name for name in result.rows[0].values if FAMILY_SUFFIX.sub("", name) not in known] == []
    if kind in ("orbit", "equilibrium"):
        assert {"first_hopf", "first_homoclinic", "bound_count"} <= set(known)  # of each kind that a branch may meet


@pytest.mark.slow
def test_many_cells_need_no_memory_for_their_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The most that a map of 6,000 cells allocates beyond one of 2,000, beside what its journal is longer."""
    meanings = {f"quantity_{k}": "a number" for k in range(30)}

    class Forgetful(Now):
        def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
            (cell,), future = given[1].cells, Future[Any]()
            values = {**dict.fromkeys(meanings, float(cell)), "end": "reached", "Omega": float(cell)}
            future.set_result(Result((Row(values),), seconds=1.0, meanings=meanings))
            return future

    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # the disk is not what is measured
    ranges = "alpha = {{ from = 1.0, to = 2.0, points = {} }}\ngamma = {{ from = 0.1, to = 0.2, points = {} }}\n"
    grown, journal = list[int](), list[int]()
    for points in ((2, 2), (50, 40), (150, 40)):  # the first loads what it takes
        tracemalloc.start()
        folder = tmp_path / str(points)
        assert Forgetful().map(folder, f"{BASE}[map]\n{ranges.format(*points)}").complete
        grown.append(tracemalloc.get_traced_memory()[1])
        journal.append((folder / "out" / "journal.msgpack").stat().st_size)
        tracemalloc.stop()
    assert journal[2] - journal[1] > 2_500_000
    assert grown[2] - grown[1] < 0.4 * (journal[2] - journal[1])


IMPORTS = "import casadi as ca\nfrom casadi_skin import OdeModel\n"
SQUARE = "p = {{ from = {0}, to = 1.0, points = {1} }}\nq = {{ from = {0}, to = 1.0, points = {1} }}\nboundary = true\n"


def of_model(folder: Path, text: str, model: str) -> Path:
    """A scene beside a model, the lines of a program that names it `good`."""
    scene = write(folder, text)
    (folder / "models.py").write_text(IMPORTS + model, encoding="utf-8")
    return scene


@pytest.mark.slow
def test_a_cell_that_fails_starts_again_from_its_neighbour(tmp_path: Path) -> None:
    """x' = -log(x - p) rests at 1 + p; 1.2 is outside of its domain from p = 1.2 on, and 2 from p = 2 on."""
    text = EQUILIBRIUM.replace("0.1", "1.2") + "[map]\np = { from = 0.0, to = 2.0, points = 5 }\n"
    logarithm = """x, p = ca.SX.sym('x'), ca.SX.sym('p')
good = OdeModel('logarithm', x, -ca.log(x - p), p, nominal=(0.0,))
"""
    found = run_map(of_model(tmp_path, text, logarithm), tmp_path / "out", pictures=False, quiet=True)
    assert found.status.tolist() == [1, 1, 1, 1, 3]
    assert found["x"][:4] == pytest.approx([1.0, 1.5, 2.0, 2.5], abs=1e-12)
    assert found["started_from"].tolist() == ["", "", "", "p = 1.0", ""]
    assert found.failures()[0][0] == "p = 2.0"
    with netcdf_file(tmp_path / "out" / "map.nc", mmap=False) as file:
        assert file.variables["started_from"].long_name == b"the cell whose solution the second start began at"


ALONG = "[map]\nalong = 'p'\np = { from = 0.0, to = 2.0, points = 9 }\nq = [0.0, 0.1]\n"
BISTABLE = """x, p, q = ca.SX.sym('x'), ca.SX.sym('p'), ca.SX.sym('q')
good = OdeModel('fold', x, p - 1 + q + 3 * x - x**3, ca.vertcat(p, q), nominal=(0.0, 0.0))
"""


def test_one_branch_serves_a_row_and_cells_that_it_does_not_reach_start_anew(tmp_path: Path) -> None:
    """x^3 - 3 x = p - 1 + q, the lowest of three: its branch turns at p = 3 - q, beyond the range."""
    text = EQUILIBRIUM.replace("0.1", "-1.5") + ALONG
    found = run_map(of_model(tmp_path / "all", text, BISTABLE), tmp_path / "out", pictures=False, quiet=True)
    assert np.all(found.status == 1)
    assert np.all(np.diff(found["x"], axis=0) > 0.0)
    for (i, j), x in np.ndenumerate(found["x"]):
        p, q = np.linspace(0.0, 2.0, 9)[i], (0.0, 0.1)[j]
        assert x == pytest.approx(min(np.roots([1.0, 0.0, -3.0, 1.0 - p - q]).real), abs=1e-9)
    assert "p" not in found.names
    two = run_map(tmp_path / "all" / "scene.toml", tmp_path / "two", pictures=False, quiet=True, workers=2)
    assert files(tmp_path / "out") == files(tmp_path / "two")
    for part in (2, 1):
        run_map(tmp_path / "all" / "scene.toml", tmp_path / "parts", pictures=False, quiet=True, part=(part, 2))
    assert files(tmp_path / "out") == files(tmp_path / "parts")
    assert two.complete


def test_orbits_between_two_whose_starts_lead_to_one_branch_are_on_it(tmp_path: Path) -> None:
    """r' = (1 - r) (r - p) (r - 3), angle' = p: from r = 2 to radius 3 for p < 2, then to 1."""
    model = "x, y, p = ca.SX.sym('x'), ca.SX.sym('y'), ca.SX.sym('p')\nr = ca.sqrt(x**2 + y**2)\n"
    model += "g = (1 - r) * (r - p) * (r - 3) / r\n"
    model += "good = OdeModel('two', ca.vertcat(x, y), ca.vertcat(x * g - p * y, y * g + p * x), p, nominal=(1.5,))\n"
    text = EQUILIBRIUM.replace("[equilibrium]\nstart = [0.1]", "[orbit]\nstart = [2.0, 0.0]\ntransient = 40.0")
    text += "[map]\np = { from = 1.5, to = 2.5, points = 20 }\n"
    found = run_map(of_model(tmp_path, text, model), tmp_path / "out", pictures=False, quiet=True)
    p = np.linspace(1.5, 2.5, 20)
    np.testing.assert_allclose(found["x_max"], np.where(p < 2.0, 3.0, 1.0), rtol=1e-7)
    np.testing.assert_allclose(found["period"], 2.0 * np.pi / p, rtol=1e-7)
    assert [len(record.cells) for record in tasks(tmp_path / "out" / "journal.msgpack")] == [16, 4]


def test_a_cell_that_the_branch_of_its_row_does_not_reach_is_tried_by_itself(tmp_path: Path) -> None:
    """x = sqrt(1 - p) ends at p = 1; nothing rests beyond but what a start of its own finds, at x = -4."""
    text = EQUILIBRIUM.replace("0.1", "1.0") + ALONG.replace("q = [0.0, 0.1]\n", "")
    model = "x, p = ca.SX.sym('x'), ca.SX.sym('p')\n"
    model += "good = OdeModel('isola', x, (1 - p - x**2) * (x + 4), p, nominal=(0.0,))\n"
    found = run_map(of_model(tmp_path, text, model), tmp_path / "out", pictures=False, quiet=True)
    reached = np.linspace(0.0, 2.0, 9) <= 1.0
    assert found["x"][reached] == pytest.approx(np.sqrt(1.0 - np.linspace(0.0, 2.0, 9)[reached]), abs=1e-6)
    assert np.all(found.status[~reached] != 0)
    records = tasks(tmp_path / "out" / "journal.msgpack")
    assert [len(record.cells) for record in records] == [9, *[1] * int(np.sum(~reached))]
    assert found.complete


def test_a_map_computes_what_its_quantities_need(tmp_path: Path) -> None:
    """Neither multipliers nor changes of stability, unless a quantity that is kept has them: with the same numbers."""
    text = BASE + "[stability]\n[map]\n" + AXES
    for names, stability in (("Omega", (None, None)), ("stable", (True, False)), ("changes", (True, True))):
        scene = parse_scene(text + f'quantities = ["{names}"]\n')
        table = asked(scene, Grid.of(scene)).stability
        assert (None if table is None else True, None if table is None else table.events) == stability
    whole, scene = parse_scene(text), parse_scene(text + 'quantities = ["max_abs_multiplier", "stable", "Omega"]\n')
    grid = Grid.of(scene)
    (task, *_), path = list(grid.tasks(grid.coarsest)), str(write(tmp_path, text))
    few, every = (Computer(plain(asked(one, grid)), path)(task) for one in (scene, whole))
    for one, other in zip(few.rows, every.rows, strict=True):
        assert "changes" not in one.values
        assert {name: other.values[name] for name in scene.map.quantities} == {  # type: ignore[union-attr]
            name: one.values[name]
            for name in scene.map.quantities  # type: ignore[union-attr]
        }


@pytest.mark.slow
def test_a_boundary_is_followed_in_both_parameters(tmp_path: Path) -> None:
    """x' = -y + r x and so on lose stability at r = p^2 + q^2 - 1/2 = 0: a circle of Hopf points."""
    text = EQUILIBRIUM.replace("[0.1]", "[0.01, 0.0]") + "[map]\n" + SQUARE.format(-1.0, "4, resolution = 0.2")
    circle = """x, y, p, q = (ca.SX.sym(n) for n in 'xypq')
r, s = p * p + q * q - 0.5, x * x + y * y
rates = ca.vertcat(r * x - y - x * s, x + r * y - y * s)
good = OdeModel('circle', ca.vertcat(x, y), rates, ca.vertcat(p, q), nominal=(0.3, 0.2))
"""
    found = run_map(of_model(tmp_path, text, circle), tmp_path / "out", quiet=True)
    (line,) = found.boundary[()]
    assert np.abs((line**2).sum(axis=1) - 0.5).max() < 1e-9
    angles = np.sort(np.arctan2(line[:, 1], line[:, 0]))
    assert np.diff(angles, append=angles[0] + 2 * np.pi).max() < 0.3  # all of it
    assert len(read_rows(tmp_path / "out" / "boundary.csv")) == len(line)
    p, q = np.meshgrid(*found.axes.values(), indexing="ij")
    rate = p**2 + q**2 - 0.5
    known = (found.status == 1) & (np.abs(rate) > 1e-9)
    assert np.all(found["stable"][known] == (rate < 0)[known])
    assert drawn(tmp_path / "out" / "map_stable.png")


@pytest.mark.slow
def test_a_boundary_of_orbits_is_followed_in_both_parameters(tmp_path: Path) -> None:
    """A circular orbit beside which two more states grow from p^2 + q^2 = 1/2 on: a quarter of a circle of tori."""
    text = EQUILIBRIUM.replace("[equilibrium]\nstart = [0.1]", "[orbit]\nstart = [1.0, 0.0, 0.0, 0.0]\nperiod = 6.28")
    text += "[stability]\n[accuracy]\ntolerance = 1e-6\n[map]\n" + SQUARE.format(0.0, 2)
    transverse = """x, y, u, v, p, q = (ca.SX.sym(name) for name in "xyuvpq")
r, s = 1.0 - x * x - y * y, p * p + q * q - 0.5 - u * u - v * v
rates = ca.vertcat(r * x - y, x + r * y, s * u - 0.3 * v, 0.3 * u + s * v)
good = OdeModel("two", ca.vertcat(x, y, u, v), rates, ca.vertcat(p, q), nominal=(0.3, 0.2))
"""
    found = run_map(of_model(tmp_path, text, transverse), tmp_path / "out", pictures=False, quiet=True)
    assert found["stable"].tolist() == [[1, 0], [0, 0]]
    (line,) = found.boundary[()]
    assert np.abs((line**2).sum(axis=1) - 0.5).max() < 1e-6
    assert (line.min(axis=0) <= 0.0).all()
    assert np.diff(np.sort(np.arctan2(line[:, 1], line[:, 0]))).max() < 0.5


@pytest.mark.slow
def test_a_boundary_of_families_is_the_edge_of_a_tongue_between_them_too(tmp_path: Path) -> None:
    """Between the families of the map against the search for changes of stability there, which follows no edge.

    With one family known it is a point.
    """
    text = BASE.replace("sites = 2", "sites = 4").replace("alpha = 1.0", "alpha = 0.5").replace("0.1\n", "0.9\n")
    text = text.replace("1e-4", "1e-8") + (
        "[stability]\n[map]\ngamma = { from = 0.42, to = 0.46, points = 2 }\n"
        "S = { from = 0.3, to = 0.9, points = 2 }\nboundary = true\n"
    )
    path, reports = write(tmp_path, text), list[str]()
    found = run_map(path, tmp_path / "out", pictures=False, quiet=True)
    (line,) = found.boundary[()]
    assert (line[:, 0].min(), line[:, 0].max()) == (0.42, 0.46)
    assert read_map(tmp_path / "out").boundary[()][0].tolist() == line.tolist()
    found.states[found.states.size // 2 :] = NOT_COMPUTED  # of gamma = 0.46
    (point,) = boundaries(parse_scene(text), path, found, reports.append)[()]
    assert (len(point), reports) == (1, [])
    for gamma, S in (*line[:: len(line) // 2], *point):
        branch = follow_family(Chain(4, 0.5, gamma, -1.0), 1, 0.9, stability=True, tolerance=1e-8)
        first = branch.first_instability()
        assert abs(first.S - S) < 1e-8


def test_an_edge_has_to_meet_its_families_and_ends_where_another_one_is_lower() -> None:
    gamma = np.linspace(0.0, 1.0, 11)
    curve: Any = {"gamma": gamma, "S": 1.0 + gamma}
    run = [Entry(0.5, 1.5, "real", 0), Entry(0.8, 1.8, "real", 0), Entry(2.0, 9.0, "real", 0)]
    assert checked(curve, "gamma", run).tolist() == np.column_stack([gamma, 1.0 + gamma]).tolist()
    with pytest.raises(ArithmeticError, match=r"it passes gamma = 0.8 elsewhere"):
        checked(curve, "gamma", [run[0], Entry(0.8, 1.9, "real", 0)])
    rising, falling = np.column_stack([gamma, 1.0 + gamma]), np.column_stack([gamma, 1.95 - gamma])[::-1]
    (low,), (other,) = lowest(rising, [falling]), lowest(falling, [rising])
    assert (low[:, 0].max(), other[:, 0].min()) == (0.4, 0.5)


def test_colours_survive_grey_and_failed_cells_are_crossed_out() -> None:
    from matplotlib import colormaps

    shades = colormaps[COLOUR_MAP](np.linspace(0.0, 1.0, 64))[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(shades) > 0)
    values, failed = np.arange(12.0).reshape(4, 3), np.zeros((4, 3), dtype=bool)
    values[1, 2], failed[1, 2] = np.nan, True
    axes = [MapAxis("a", np.arange(4.0)), MapAxis("b", np.array([1.0, 10.0, 100.0]), True)]
    panel = map_figure("name", "title", axes, [Panel("", values, failed, np.ones((4, 3), dtype=bool))]).axes[0]
    (cross,) = [line for line in panel.lines if line.get_marker() == "x"]
    assert (cross.get_xdata(), cross.get_ydata()) == ([1.0], [100.0])
    assert len(panel.collections) > 1  # contour lines
    assert panel.get_yscale() == "log"
    on_a_line = np.arange(4)[:, None] == np.arange(3)  # of a refined map: there is no contour between these
    even, numbers = [axes[0], MapAxis("b", np.arange(3.0))], np.arange(12.0).reshape(4, 3)
    panel = map_figure("name", "title", even, [Panel("", numbers, failed, on_a_line)]).axes[0]
    assert len(panel.collections) == 1


LATTICE = (
    lattice([4], "alpha*y + g*y^3", parameters={"alpha": {"low": 0.9, "high": 1.1, "seed": 1}, "g": 1.0})
    + family(1, 0.05)
    + """[map]
seed = { from = 1, to = 3, points = 3 }
"g, mode" = [[1.0, 1], [-1.0, 4]]
S = [0.01, 0.05]
"""
)


def test_values_go_where_they_belong_in_the_scene_of_a_cell() -> None:
    """Seeds of a lattice, parameters that move together, and S of a family, whose cells are one task."""
    scene = parse_scene(LATTICE)
    grid = Grid.of(scene)
    *others, last = grid.tasks(grid.coarsest)
    assert [task.cells for task in (*others, last)] == [(0, 1), (2, 3), (4, 5), (6, 7), (8, 9), (10, 11)]
    cell = msgspec.to_builtins(scene_at(plain(scene), last.settings, last.amplitudes))
    parameters, family = cell["lattice"]["parameters"], cell["family"]
    assert (parameters["alpha"]["seed"], parameters["g"], family["mode"]) == (3, -1.0, 4)
    assert (list(family["at"]), family["amplitude_max"]) == ([0.01, 0.05], 0.05)
    assert grid.name(11) == "seed = 3, g, mode = (-1.0, 4), S = 0.05"


def test_panels_name_the_parameters_that_change_together_one_by_one(tmp_path: Path) -> None:
    kept(tmp_path, LATTICE.replace("[1.0, 1], [-1.0, 4]", '[1.0, "first"], [-1.0, "last"]'), [])
    titles = [axes.get_title() for axes in read_map(tmp_path).figure("Omega").axes if axes.get_title()]
    assert any("g = $-1$, mode = last" in title for title in titles)
    assert len(titles) == 4


def test_lines_of_a_boundary_are_read_as_they_were_written(tmp_path: Path) -> None:
    """Bit for bit, beside an axis with commas in its name and its values."""
    found = kept(tmp_path, LATTICE.replace("S = [0.01, 0.05]", "S = { from = 0.01, to = 0.05, points = 2 }"), [])
    rng = np.random.default_rng(1)
    lines = {(0,): (rng.random((3, 2)), rng.random((1, 2))), (1,): (1e-300 * rng.random((2, 2)),)}
    found.write_boundary(lines)
    assert [len(row) for row in read_rows(tmp_path / "boundary.csv")] == [4] * 6
    read = {chosen: [curve.tolist() for curve in curves] for chosen, curves in read_map(tmp_path).boundary.items()}
    assert read == {chosen: [curve.tolist() for curve in curves] for chosen, curves in lines.items()}


def test_a_parameter_of_the_user_has_no_meaning_of_the_chain(tmp_path: Path) -> None:
    """`gamma` is the nonreciprocity of a chain alone, in the names of a map's axes."""
    of_user = LATTICE.replace('{"low" = 0.9, "high" = 1.1, "seed" = 1}', '1.0, "gamma" = 0.1').replace(
        "*y +", "*y + gamma*y +"
    )
    for text, words in ((of_user, b"the parameter lattice.parameters.gamma"), (TINY, b"nonreciprocity")):
        folder = tmp_path / words.decode()
        kept(folder, text.partition("[map]")[0] + "[map]\ngamma = [0.1, 0.2]\n", []).write({}, True, False)
        with netcdf_file(folder / "map.nc", mmap=False) as file:
            assert file.variables["gamma"].long_name == words
