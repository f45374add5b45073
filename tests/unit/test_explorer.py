"""The page that shows a run: what it holds, and that it works in a browser."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from pages import browser as browser
from pages import data_in, explored, opened, settled, write_map
from scenes import Cli

from casadi_skin import Chain, OdeModel, find_equilibrium, follow_family
from casadi_skin.follow.branch import Branch
from casadi_skin.results.dataset import Dataset, Variable, dataset_of, write_csv, write_netcdf
from casadi_skin.results.tables import EVENT_COLUMNS, event_rows
from casadi_skin.runs.explorer import CHANGE_NAME, MOST_CURVE_POINTS, map_data, page_data
from casadi_skin.runs.program import main
from casadi_skin.stability.tongues.diagram import Unresolved


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The netCDF file of a run of two families."""
    folder = tmp_path_factory.mktemp("run")
    chain = Chain(2, 1.0, 0.25, -1.0)
    families = [follow_family(chain, j, 0.5, stability=True, tolerance=1e-4, at=[0.2]) for j in (1, 2)]
    write_netcdf(folder / "family.nc", Dataset(dataset_of(families).variables, {"title": "two <modes>"}))
    return folder


def test_a_page_holds_the_run_and_asks_for_nothing_else(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = explored(run)
    assert capsys.readouterr().out == f"wrote {page}; open it in a browser\n"
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img)\b[^>]*(src|href)=", text[:5000] + text[-20_000:])
    assert "<title>two &lt;modes&gt;</title>" in text
    first, second = data_in(page)["branches"]
    assert (first["name"], second["name"]) == ("mode 1", "mode 2")
    place = first["requested"][0]
    assert first["columns"]["S"][place] == 0.2
    k = first["detail"]["point"].index(place)
    wave = np.array(first["detail"]["waves"][k])
    assert np.sum(wave[:, 0] ** 2) == pytest.approx(0.2, rel=1e-5)
    assert len(first["detail"]["multipliers"][k]) == 8
    page.unlink()


def test_a_long_branch_is_thinned_with_a_note(tmp_path: Path) -> None:
    n = 10_000
    x = np.linspace(0.0, 1.0, n)
    of_points = {
        "requested": (x == 1.0).astype(int), "stable": (x < 0.5).astype(int), "parameters": x[:, None],
        "states": np.sin(x)[:, None],
    }  # fmt: skip
    variables = [Variable(k, ("point", k[:-1])[: v.ndim], v, k) for k, v in of_points.items()]
    variables += [Variable(f"{k}_name", (k,), np.array([v]), "names") for k, v in (("parameter", "p"), ("state", "u"))]
    write_netcdf(tmp_path / "branch.nc", Dataset(variables))
    data = page_data(tmp_path)
    (branch,) = data["branches"]
    assert data["note"] == f"curves show {MOST_CURVE_POINTS} of the points of 1 branches"
    assert (branch["count"], branch["x"], branch["y"]) == (n, "p", "u")
    assert MOST_CURVE_POINTS <= len(branch["columns"]["p"]) <= MOST_CURVE_POINTS + 3
    (change,) = branch["special"]
    assert change["label"].startswith(f"{CHANGE_NAME}: p = ")
    assert branch["columns"]["p"][change["point"]] == pytest.approx(0.5, abs=1e-4)
    assert [branch["columns"]["p"][i] for i in branch["requested"]] == [1.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no"], "does not exist"),
        (["odd.skin"], "holds <Orbit"),
        (["."], "holds no branches"),
        ([".", "--out", "a.txt"], "ends in .html"),
    ],
)
def test_what_is_no_run_is_refused(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(tmp_path)
    follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.1, tolerance=1e-4).orbits[-1].save("odd.skin")
    assert words in cli("explore", *arguments).line


@pytest.mark.parametrize("kind", ["run", "map"])
def test_damaged_files_are_refused_in_one_line(
    kind: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cut off, with offsets and sizes of nothing, with another table beside them: a page or one line, no traceback."""
    name = "family.nc" if kind == "run" else "map.nc"
    if kind == "run":
        shutil.copy(run / name, tmp_path)
    else:
        write_map(tmp_path)
    good, random = (tmp_path / name).read_bytes(), np.random.default_rng(3)
    refused = 0
    for length in (0, 3, 40, len(good) // 3, *[len(good)] * 16):
        data = bytearray(good[:length])
        for place in random.integers(4, min(2000, len(good)), 4 if length == len(good) else 0):
            data[place] = (0, 255, 127)[place % 3]
        (tmp_path / name).write_bytes(data)
        status = main(["explore", str(tmp_path)])
        words = capsys.readouterr().err
        assert status in (0, 2)
        assert status == 0 or (words.startswith(f"casadi-skin: explore: {tmp_path}") and words.count("\n") == 1)
        refused += status == 2
    assert refused > 4


def test_a_saved_branch_and_a_saved_diagram_are_shown(tmp_path: Path) -> None:
    family = follow_family(Chain(8, 1.0, 0.25, -1.0), 1, 0.5, stability=True, tolerance=1e-6)
    (branch,) = data_in(explored(family.save(tmp_path / "family.skin")))["branches"]
    assert [p["kind"].split(" (")[0] for p in branch["special"]] == ["stability lost", "stability regained"]
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    field = ca.vertcat(mu * x - y - x * (x**2 + y**2), x + mu * y - y * (x**2 + y**2))
    rest = find_equilibrium(OdeModel("Hopf", ca.vertcat(x, y), field, mu), [0.0, 0.0], parameters={"mu": -0.25})
    diagram = rest.follow("mu", 0.1).follow_all(depth=1)
    explored(diagram.save(tmp_path / "all.skin"), "--out", str(tmp_path / "page.html"))
    branches = data_in(tmp_path / "page.html")["branches"]
    assert len(branches) == len(diagram.branches) == 2
    assert "hopf" in [point["kind"] for point in branches[0]["special"]]


def write_family(folder: Path, sites: int, S: float, unresolved: tuple[Unresolved, ...] = ()) -> Branch:
    """A family with the table of its changes of stability beside it, as a run writes them."""
    family = follow_family(Chain(sites, 1.0, 0.25, -1.0), 1, S, stability=True, tolerance=1e-6)
    assert family.stability_diagram is not None
    assert len(family.changes) > 1
    write_netcdf(folder / "family.nc", Dataset(dataset_of([family]).variables, {}))
    rows = event_rows(1, replace(family.stability_diagram, unresolved=unresolved))
    write_csv(folder / "events.csv", EVENT_COLUMNS, rows)
    return family


def test_changes_of_stability_and_stretches_stand_where_they_are_located(tmp_path: Path) -> None:
    """Rows of events.csv without a frequency, and one without a place: all are listed, and no file is blamed."""
    left = Unresolved(0.25, 0.26, 0.0, 1.0, "no orbit"), Unresolved(np.nan, np.nan, 0.0, 1.0, "no orbit")
    family = write_family(tmp_path, 8, 0.5, left)
    (branch,) = page_data(tmp_path)["branches"]
    listed = [special for special in branch["special"] if special["kind"].startswith("stability")]
    S = branch["columns"]["S"]
    for special, change in zip(listed, family.changes, strict=True):
        k, part = divmod(special["place"], 1)
        assert S[int(k)] + part * (S[min(int(k) + 1, len(S) - 1)] - S[int(k)]) == pytest.approx(change.S, rel=1e-3)
        assert special["kind"].startswith("stability lost" if change.stable_before else "stability regained")
        assert special["label"].endswith(f"S = {change.S:.8g}")
    words = "unresolved, changes of stability may be missing"
    unresolved = [special for special in branch["special"] if special["label"].startswith("unresolved")]
    assert [special["label"] for special in unresolved] == [
        f"{words} somewhere along the family", f"{words} over 0.01 in S: S = 0.25",
    ]  # fmt: skip
    place = int(unresolved[1]["place"])
    assert S[place] <= 0.25 <= S[place + 1]


def test_a_map_becomes_a_page(tmp_path: Path) -> None:
    values = write_map(tmp_path)
    data = data_in(explored(tmp_path))
    assert [(axis["name"], axis["numbers"], len(axis["values"])) for axis in data["axes"]] == [
        ("gamma", True, 3), ("S", True, 4), ("mode", False, 2),
    ]  # fmt: skip
    growth, Omega = data["quantities"]
    assert (growth["name"], growth["words"], Omega["name"]) == ("growth", "growth of perturbations", "Omega")
    np.testing.assert_allclose(np.array(growth["values"], dtype=float), values.ravel(), rtol=1e-6)
    assert (data["note"], data["status"][2], data["reasons"][2]) == ("", 3, "no orbit")


def test_a_large_map_is_thinned_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("casadi_skin.runs.explorer.MOST_CELLS", 400)
    write_map(tmp_path, 30, 20, "γ")
    data = map_data(tmp_path)
    sizes = [len(axis["values"]) for axis in data["axes"]]
    assert np.prod(sizes) == len(data["status"]) <= 400
    assert data["note"] == f"{np.prod(sizes)} of 1200 cells are shown"
    assert [axis["name"] for axis in data["axes"]] == ["γ", "S", "mode"]
    assert (data["axes"][0]["values"][0], data["axes"][0]["values"][-1]) == (0.1, 0.3)


def click_at(page: Any, x: float, y: float) -> None:
    """A click on the largest picture, at values of its axes."""
    place = page.evaluate(
        "([x, y]) => { const f = document.getElementById('curve')._fullLayout;"
        " return [f.xaxis._offset + f.xaxis.l2p(x), f.yaxis._offset + f.yaxis.l2p(y)]; }",
        [x, y],
    )
    box = page.locator("#curve").bounding_box()
    page.mouse.move(box["x"] + place[0], box["y"] + place[1])
    page.wait_for_timeout(200)
    page.mouse.click(box["x"] + place[0], box["y"] + place[1])
    page.wait_for_timeout(200)


@pytest.mark.slow
def test_a_page_works_in_a_browser(run: Path, browser: Any) -> None:
    page, told = opened(browser, explored(run))
    values = page.locator("#values")

    def drawn() -> str:
        settled(page)
        return str(page.evaluate("document.getElementById('wave').data[0].y.join()"))

    first, wave = values.inner_text(), drawn()
    assert first.startswith("mode 1, point 0 of ")
    page.keyboard.press("End")
    assert values.inner_text() != first
    assert drawn() != wave
    page.keyboard.press("ArrowDown")
    assert values.inner_text().startswith("mode 2, ")
    first_branch = page.evaluate("data.branches[0].columns")
    click_at(page, first_branch["S"][9], first_branch["Omega"][9])
    assert values.inner_text().startswith("mode 1, point 9 of ")
    profile = "document.getElementById('profile').data[0].y.join()"
    before = page.evaluate(profile)
    page.locator("#play").click()
    page.wait_for_timeout(400)
    assert page.evaluate(profile) != before
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != dark
    assert told == []


@pytest.mark.slow
def test_special_points_are_listed_and_lead_to_their_place(tmp_path: Path, browser: Any) -> None:
    family = write_family(tmp_path, 6, 3.0)
    page, said = opened(browser, explored(tmp_path))
    buttons = page.locator("#points button")
    assert buttons.count() == len(family.changes)
    buttons.nth(1).click()
    assert f"S = {family.changes[1].S:.8g}" in page.locator("#values").inner_text()
    assert buttons.nth(1).get_attribute("aria-current") == "true"
    settled(page)
    ring = page.evaluate("document.getElementById('curve').layout.shapes[0].xanchor")
    assert ring == pytest.approx(family.changes[1].S, rel=1e-3)
    page.keyboard.press("s")
    assert buttons.nth(2 % len(family.changes)).get_attribute("aria-current") == "true"
    assert said == []


@pytest.mark.slow
def test_a_map_works_in_a_browser(tmp_path: Path, browser: Any) -> None:
    write_map(tmp_path)
    page, said = opened(browser, explored(tmp_path))
    values = page.locator("#values")
    assert values.inner_text().startswith("gamma = 0.1, S = 0, mode = first: done")
    page.keyboard.press("ArrowUp")
    assert "failed (no orbit)" in values.inner_text()
    page.keyboard.press("End")
    assert values.inner_text().startswith("gamma = 0.3, S = 0.3333333, mode = first: done")
    click_at(page, 0.2, 1.0)
    assert values.inner_text().startswith("gamma = 0.2, S = 1, mode = first: done; growth = 0.2")
    before = page.evaluate("document.getElementById('curve').layout.images[0].source")
    page.locator("#others select").select_option("last")
    page.wait_for_timeout(200)
    assert "growth = -0.2" in values.inner_text()
    assert page.evaluate("document.getElementById('curve').layout.images[0].source") != before
    page.locator("#x").select_option("S")
    page.wait_for_timeout(200)
    assert page.evaluate("document.getElementById('along').data[0].x.length") == 4
    page.locator("#theme").click()
    assert said == []
