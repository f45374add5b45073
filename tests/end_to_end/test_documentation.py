"""What the pages of the documentation show runs as it stands, and is as long as a page may be."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl
import pytest

from casadi_skin.scene import parse_scene

DOCS = Path(__file__).parents[2] / "docs"
RUN = (
    "results",
    "my_chain",
    "my_lattice",
    "my_ode",
    "from_auto",
    "from_matcont",
    "from_bifurcationkit",
    "from_solve_bvp",
)
MOST_WORDS = 1500


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / f"{page}.md").read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_the_programs_of_a_page_run_one_after_the_other(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, f"{page}.md", "exec"), names)
    mpl.pyplot.close("all")
    branch = names.get("branch")
    if page == "from_auto":
        assert [round(p.parameters["p1"], 7) for p in branch.special_points] == [0.105739, 0.0889318, 0.13090]  # type: ignore[attr-defined]
    if page == "from_matcont":
        assert names["doubling"].parameters["alpha"] == pytest.approx(0.630302, abs=5e-7)  # type: ignore[attr-defined]
        assert names["doubling"].solution.period == pytest.approx(6.364071, abs=5e-7)  # type: ignore[attr-defined]
    if page == "from_solve_bvp":
        assert names["solution"]["k"] == pytest.approx(6.283185307179586, rel=1e-8)  # type: ignore[index]


@pytest.mark.parametrize("page", ["my_chain", "my_lattice"])
def test_the_scenes_of_a_page_are_accepted(page: str) -> None:
    (scene,) = blocks(page, "toml")
    parse_scene(scene, page)


@pytest.mark.parametrize("page", [*RUN, "command_line"])
def test_a_page_is_read_in_one_go(page: str) -> None:
    assert len((DOCS / f"{page}.md").read_text(encoding="utf-8").split()) < MOST_WORDS
