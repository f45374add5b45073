"""AUTO-07p's demos: the numbers of the page are those of the script, AUTO's, and closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from outputs import load
from scipy.optimize import brentq

DEMOS = load("auto_demos")
PAGE = Path(__file__).parents[2] / "docs" / "auto_demos.md"
DIGITS = 1.5e-5  # relative: AUTO shows six digits, and some of its own are wrong in the last
COARSE = {("lin", 4.00023): 6e-5, ("cusp", 3.02839e-08): 1.0}


def page_rows() -> Iterator[tuple[str, str, float, float]]:
    """Demo, what, AUTO's number and the one here of each row of the page's first table."""
    demo, (points, _) = "", PAGE.read_text(encoding="utf-8").split("## Curves in two parameters")
    for line in points.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 6 and cells[4] != "---" and cells[3] != "here":
            demo = cells[0].strip("`") or demo
            yield demo, cells[1], float(cells[2]), float(cells[3])


def exact(demo: str, auto: float) -> float | None:
    """The closed form of a number; None where there is none."""
    if demo == "ab" and auto < 0.1116 and auto != 0.111153:  # p2/(1 + p3) x (1 - x) = 1
        x = 1 / 3 if auto > 0.1 else 2 / 3
        return float(x / (1 - x) * np.exp(-4.5 * x))
    if demo in ("bvp", "lin"):
        return float(round(auto))
    if demo == "exp":
        z = brentq(lambda z: z * np.tanh(z) - 1.0, 1.0, 2.0, xtol=1e-15)
        return float(8.0 * (z**2 - 1.0))
    if demo == "nag":
        return float(np.copysign(0.5, auto) / np.sqrt(2))
    known = {("lrz", 24.7368): 470 / 19, ("cusp", 0.3849): 2 / np.sqrt(27), ("pp2", 0.6): 0.6, ("pp3", 0.75): 0.75}
    return known.get((demo, auto))


def test_the_page_has_twelve_demos_and_more() -> None:
    assert {demo for demo, *_ in page_rows()} == set(DEMOS.DEMOS)
    assert len(DEMOS.DEMOS) >= 12


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(DEMOS.DEMOS))
def test_special_points_are_those_of_auto_and_of_the_page(name: str) -> None:
    ((rows, _),) = DEMOS.main(name).values()
    shown = {(what, auto): here for demo, what, auto, here in page_rows() if demo == name}
    assert len(shown) == len(rows)
    for row in rows:
        allowed = COARSE.get((name, row.auto), DIGITS)
        assert abs(row.value - row.auto) <= allowed * max(abs(row.auto), 1e-3)
        assert abs(row.value - shown[row.what, row.auto]) <= row.error + 1e-10 * abs(row.value)
        assert row.error < 1e-6 * max(abs(row.value), 1.0)
        closed = exact(name, row.auto)
        if closed is not None:
            assert abs(row.value - closed) <= max(2.0 * row.error, 4e-16 * abs(closed))
