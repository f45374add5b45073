"""The page that shows a run: what it holds, and that it works in a browser."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.cli import main
from casadi_skin.explorer.data import POINTS, page_data
from casadi_skin.results.dataset import Dataset, Variable, write_netcdf
from casadi_skin.results.quantities import dataset_of


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The netCDF file of a run of two families."""
    folder = tmp_path_factory.mktemp("run")
    chain = Chain(2, 1.0, 0.25, -1.0)
    families = [follow_family(chain, j, 0.5, stability=True, tolerance=1e-4, at=[0.2]) for j in (1, 2)]
    write_netcdf(folder / "family.nc", Dataset(dataset_of(families).variables, {"title": "two <modes>"}))
    return folder


def data_in(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def test_a_page_holds_the_run_and_asks_for_nothing_else(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", str(run)]) == 0
    page = run / "explore.html"
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
    named = {"requested": (x == 1.0).astype(int), "stable": (x < 0.5).astype(int), "parameters": x[:, None]}
    dimensions = {"parameters": ("point", "parameter")}
    variables = [Variable(k, dimensions.get(k, ("point",)), v, k) for k, v in named.items()]
    variables.append(Variable("parameter_name", ("parameter",), np.array(["p"]), "names"))
    variables.append(Variable("states", ("point", "state"), np.sin(x)[:, None], "states"))
    variables.append(Variable("state_name", ("state",), np.array(["u"]), "names"))
    write_netcdf(tmp_path / "branch.nc", Dataset(variables))
    data = page_data(tmp_path)
    (branch,) = data["branches"]
    assert data["note"] == f"curves show {POINTS} of the points of 1 branches"
    assert (branch["count"], branch["x"], branch["y"]) == (n, "p", "u")
    assert POINTS <= len(branch["columns"]["p"]) <= POINTS + 3
    (change,) = branch["special"]
    assert branch["columns"]["p"][change["point"]] == pytest.approx(0.5, abs=1e-4)
    assert [branch["columns"]["p"][i] for i in branch["requested"]] == [1.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["no"], "is no directory"), (["."], "holds no branches"), ([".", "--out", "a.txt"], "ends in .html")],
)
def test_what_is_no_run_is_refused(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["explore", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.fixture
def browser() -> Iterator[Any]:
    """Chromium of the system, without network; skipped where there is none."""
    sync = pytest.importorskip("playwright.sync_api")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("needs chromium")
    with sync.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium.new_context(viewport={"width": 1366, "height": 768}, offline=True)
        chromium.close()


@pytest.mark.slow
def test_a_page_works_in_a_browser(run: Path, browser: Any) -> None:
    assert main(["explore", str(run), "--quiet"]) == 0
    page, told = browser.new_page(), list[str]()
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.goto(f"file://{run / 'explore.html'}")
    page.wait_for_selector("html[data-ready=yes]")
    values = page.locator("#values")

    def drawn() -> str:
        page.wait_for_function("!pending")
        return str(page.evaluate("document.getElementById('wave').data[0].y.join()"))

    first, wave = values.inner_text(), drawn()
    assert first.startswith("mode 1, point 0 of ")
    page.keyboard.press("End")
    assert values.inner_text() != first
    assert drawn() != wave
    page.keyboard.press("ArrowDown")
    assert values.inner_text().startswith("mode 2, ")
    place = page.evaluate(
        "(() => { const f = document.getElementById('curve')._fullLayout, c = data.branches[0].columns;"
        " return [f.xaxis._offset + f.xaxis.l2p(c.S[9]), f.yaxis._offset + f.yaxis.l2p(c.Omega[9])]; })()"
    )
    box = page.locator("#curve").bounding_box()
    page.mouse.move(box["x"] + place[0], box["y"] + place[1])
    page.wait_for_timeout(200)
    page.mouse.click(box["x"] + place[0], box["y"] + place[1])
    page.wait_for_timeout(200)
    assert values.inner_text().startswith("mode 1, point 9 of ")
    before = page.evaluate("document.getElementById('profile').data[0].y.join()")
    page.locator("#play").click()
    page.wait_for_timeout(400)
    assert page.evaluate("document.getElementById('profile').data[0].y.join()") != before
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != dark
    assert told == []
