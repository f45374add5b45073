"""Pages of the explorer: made, read, and opened in a browser."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casadi_skin.results.dataset import Dataset, Variable, write_netcdf
from casadi_skin.runs.program import main


def data_in(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    return dict(json.loads(found[1]))


def explored(source: Path, *words: str) -> Path:
    """The page of a run, a map or a file of one."""
    assert main(["explore", str(source), *words]) == 0
    return source.with_suffix(".html") if source.is_file() else source / "explore.html"


def write_map(folder: Path, gammas: int = 3, amplitudes: int = 4, first: str = "gamma") -> np.ndarray:
    """A map of a product over two ranges and a list; one cell failed."""
    gamma, S = np.linspace(0.1, 0.3, gammas), np.linspace(0.0, 1.0, amplitudes)
    values = (gamma[:, None, None] * S[None, :, None]) * np.array([1.0, -1.0])
    status, reason = np.ones(values.shape, dtype=np.int32), np.full(values.shape, "", dtype=object)
    status[0, 1, 0], reason[0, 1, 0], values[0, 1, 0] = 3, "no orbit", np.nan
    axes = (first, "S", "mode")
    variables = [
        Variable(first, axes[:1], gamma, "nonreciprocity"),
        Variable("S", axes[1:2], S, "amplitude"),
        Variable("mode", axes[2:], np.array(["first", "last"]), "mode"),
        Variable("status", axes, status, "state of a cell"),
        Variable("reason", axes, reason, "why it failed"),
        Variable("growth", axes, values, "growth of perturbations", may_be_empty=True),
        Variable("Omega", axes, 1.0 + values**2, "frequency", may_be_empty=True),
    ]
    write_netcdf(folder / "map.nc", Dataset(variables, {"title": "a map"}))
    return values


@pytest.fixture
def browser() -> Iterator[Any]:
    """Chromium of the system, without network; skipped where there is none."""
    sync = pytest.importorskip("playwright.sync_api")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync.sync_playwright() as play:
        quiet = ["--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"]
        chromium = play.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu", *quiet])
        yield chromium.new_context(viewport={"width": 1366, "height": 768}, offline=True)
        chromium.close()


def opened(browser: Any, path: Path) -> tuple[Any, list[str]]:
    """A page once it is ready, and what it says on the console."""
    page, said = browser.new_page(), list[str]()
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(f"file://{path}")
    page.wait_for_selector("html[data-ready=yes]")
    return page, said


def settled(page: Any) -> None:
    """Wait until all pictures are drawn; a page's policy lets nobody evaluate text in it, as wait_for_function does."""
    while not page.evaluate("!pending && !waiting && !queue.length"):
        page.wait_for_timeout(20)
