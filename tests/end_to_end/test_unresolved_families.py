"""A family on which changes of stability may be missing: nothing that counts them is printed as if it were complete."""

from __future__ import annotations

from functools import partial

import pytest
from scenes import Runs, chain, family

from casadi_skin import Chain, follow_family
from casadi_skin.follow import family_changes
from casadi_skin.stability.tongues.find_changes import find_changes


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
def test_run_with_unresolved_changes_ends_with_status_1_and_says_why_in_a_line(run: Runs) -> None:
    done = run(chain(24) + family() + "[stability]\nevents = true\n", status=1)
    assert "at least 0" in done.out
    assert done.err.count("\n") == 1
    assert "limit of work" in done.err
    assert "family.csv" in run.files
    assert [row["kind"] for row in run.rows("events")] == ["unresolved"]
