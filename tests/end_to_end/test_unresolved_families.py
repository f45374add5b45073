"""A family on which changes of stability may be missing: nothing that counts them is printed as if it were complete."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from outputs import read_rows

from casadi_skin import Chain, follow_family
from casadi_skin.follow import family_changes
from casadi_skin.runs.program import main
from casadi_skin.stability.tongues.find_changes import find_changes

SCENE = """[chain]
sites = 24
alpha = 1.0
gamma = 0.25
g = -1.0
[family]
mode = 1
amplitude_max = 1.0
[stability]
events = true
"""


@pytest.fixture
def _little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(family_changes, "find_changes", partial(find_changes, work=1.0))


@pytest.mark.usefixtures("_little_work")
def test_counts_of_changes_beside_something_unresolved_are_the_least() -> None:
    branch = follow_family(Chain(24, 1.0, 0.25, -1.0), mode=1, amplitude_max=1.0, stability=True)
    assert branch.unresolved
    assert branch.stability_diagram is not None
    for words in (repr(branch), repr(branch.stability_diagram)):
        assert f"at least {len(branch.changes)} changes of stability" in words
    for words in (str(branch), str(branch.stability_diagram)):
        (line,) = (line for line in words.splitlines() if line.strip().startswith("changes"))
        assert line.endswith("none found; see unresolved")


@pytest.mark.usefixtures("_little_work")
def test_run_with_unresolved_changes_ends_with_status_1_and_says_why_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(out)]) == 1
    printed, told = capsys.readouterr()
    assert "at least 0" in printed
    assert told.count("\n") == 1
    assert "limit of work" in told
    assert (out / "family.csv").is_file()
    assert [row["kind"] for row in read_rows(out / "events.csv")] == ["unresolved"]
