"""Names that are tags, styles, scripts or marks of the page are shown as text, and nothing is asked of a network."""

from __future__ import annotations

import re
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import browser as browser
from pages import data_in, explored

from casadi_skin.results.dataset import Dataset, Variable, write_netcdf

TAG = '<span style="background:url(http://127.0.0.1:9/{0})">{0}</span><a href="http://127.0.0.1:9/l">&lt;{0}</a>'
CODE = "</script><script>document.title='taken'</script><img src=x onerror=\"document.title='taken'\">@PLOTLY@ $&"


def hostile_run(folder: Path, title: str = CODE) -> Path:
    """A branch of orbits whose names are tags."""
    n, words = 12, np.array([TAG.format("state"), TAG.format("second"), "constructor"])
    x, phase = np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, 49)
    waves = np.cos(2 * np.pi * phase)[None, :, None] * (1.0 + x[:, None, None]) * np.array([1.0, 2.0, 3.0])
    variables = [
        Variable("requested", ("point",), (x == 1.0).astype(int), "requested"),
        Variable("stable", ("point",), (x < 0.5).astype(int), "stable"),
        Variable("parameter_name", ("parameter",), np.array([TAG.format("parameter")]), "names"),
        Variable("parameters", ("point", "parameter"), x[:, None], "values"),
        Variable("state_name", ("state",), words, "names"),
        Variable("states", ("point", "state"), waves[:, 0], "states"),
        Variable("profile", ("point", "phase", "state"), waves, "profile"),
    ]
    write_netcdf(folder / "branch.nc", Dataset(variables, {"title": title}))
    return explored(folder)


def hostile_map(folder: Path) -> Path:
    axes = ("p", "kind")
    variables = [
        Variable("p", axes[:1], np.linspace(0.0, 1.0, 3), TAG.format("axis")),
        Variable("kind", axes[1:], np.array([TAG.format("one"), TAG.format("two")]), TAG.format("list")),
        Variable("status", axes, np.array([[1, 1], [1, 3], [1, 1]]), "status"),
        Variable("reason", axes, np.full((3, 2), TAG.format("reason"), dtype=object), "why"),
        Variable("growth", axes, np.arange(6.0).reshape(3, 2), TAG.format("growth")),
    ]
    write_netcdf(folder / "map.nc", Dataset(variables, {"title": CODE}))
    return explored(folder)


PAGES = [hostile_run, hostile_map]


@pytest.mark.parametrize("made", PAGES)
def test_a_page_runs_its_own_scripts_alone_and_fetches_nothing(made: Any, tmp_path: Path) -> None:
    text = made(tmp_path).read_text(encoding="utf-8")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    rules = dict(rule.strip().partition(" ")[::2] for rule in policy.split(";"))
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = [f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" for script in scripts]
    assert len(hashes) == 3
    assert rules == {
        "default-src": "'none'", "script-src": " ".join(hashes), "style-src": "'unsafe-inline'",
        "img-src": "data: blob:", "base-uri": "'none'", "form-action": "'none'",
    }  # fmt: skip
    assert text.index("Content-Security-Policy") < text.index("<title>") < text.index("<script")
    assert [len(re.findall(r"Plotly\.react\(", script)) for script in scripts[1:]] == [1, 0]  # in `react` alone


@pytest.mark.parametrize("title", ["@DATA@", "@TITLE@", "@PLOTLY@ @SCRIPT@", r"\1 \g<0> $&", CODE])
def test_a_title_is_a_title(title: str, tmp_path: Path) -> None:
    page = hostile_run(tmp_path, title)
    assert data_in(page)["title"] == title
    assert page.read_text(encoding="utf-8").count("plotly.js (basic - minified)") == 1


@pytest.mark.slow
@pytest.mark.parametrize("made", PAGES)
def test_names_are_shown_as_they_are_and_nothing_is_asked_for(made: Any, tmp_path: Path, browser: Any) -> None:
    path, page = made(tmp_path), browser.new_page()
    asked, said, dialogs = list[str](), list[str](), list[Any]()
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("dialog", lambda dialog: dialogs.append(dialog))
    page.goto(f"file://{path}")
    page.wait_for_selector("html[data-ready=yes]")
    page.wait_for_timeout(500)
    curve = page.locator("#curve .main-svg").first.bounding_box()
    for part in (0.3, 0.5, 0.7):  # what hovers is drawn, too
        page.mouse.move(curve["x"] + part * curve["width"], curve["y"] + part * curve["height"])
        page.wait_for_timeout(100)
    shown = page.evaluate("[...document.querySelectorAll('.main-svg text')].map((t) => t.textContent).join(' ')")
    assert TAG.format("axis" if made is hostile_map else "parameter") in shown
    assert page.evaluate("document.querySelectorAll('svg a, svg tspan[style*=url]').length") == 0
    assert page.title() == CODE
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [f"file://{path}"]
    assert (said, dialogs) == ([], [])
