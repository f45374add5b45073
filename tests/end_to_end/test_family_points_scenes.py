"""Scenes that follow what leaves families, and edges of their tongues: files, also after an interruption."""

from __future__ import annotations

from typing import Any

import pytest
from scenes import Runs, chain, family, table

from casadi_skin import Chain, follow_family
from casadi_skin.follow.special_points import SpecialPoint

SCENE = chain(3) + family(1, 2.6) + "[stability]\n" + table(
    "continuation", parameter="S", to=2.62, switch=["branch point"], max_points=60,
    curve={"parameter": "gamma", "to": 0.27, "further": True},
)  # fmt: skip


@pytest.mark.slow
def test_what_leaves_a_family_and_the_edges_of_its_tongues_are_in_files(
    run: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Special points as from Python; the edge against the changes of stability of the family at its last gamma."""
    follow, calls = SpecialPoint.curve, []

    def curve(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return follow(*arguments, **options)

    monkeypatch.setattr(SpecialPoint, "curve", curve)
    run(SCENE, status=130)
    printed = run(SCENE, "--resume").out
    assert len(calls) == 4  # three edges, of which the first one is in the journal
    assert "branches that leave: 2" in printed
    assert "edges of tongues: 3" in printed  # two between unstable orbits
    branch = follow_family(Chain(3, 1.0, 0.25, -1.0), 1, 2.6, stability=True)
    points = [row for row in run.rows("special_points") if row["branch"] == "j1"]
    assert [(p["kind"], p["loses"]) for p in points] == [(p.kind, ", ".join(p.lost)) for p in branch.special_points]
    assert [float(p["S"]) for p in points] == pytest.approx([p.parameters["S"] for p in branch.special_points])
    edges = run.rows("edges")
    last = [row for row in edges if row["table"] == "events.csv"][-1]
    ends = {row["edge"]: float(row["S"]) for row in edges if row["table"] == "further_events.csv"}
    assert float(last["gamma"]) == 0.27
    there = follow_family(Chain(3, 1.0, 0.27, -1.0), 1, 3.0, stability=True)
    known, *_ = there.changes
    assert list(ends.values()) == pytest.approx([edge.S for edge in there.stability_diagram.further[:2]], rel=1e-9)
    assert float(last["S"]) == pytest.approx(known.S, rel=1e-10)
    assert 0.0 < float(last["S_error"]) < 1e-10
    for number, point in enumerate(points, start=1):
        leaving = run.rows(f"other_j1_{number}")
        assert float(leaving[0]["S"]) == pytest.approx(float(point["S"]))
        assert (run.out / f"other_j1_{number}.nc").is_file()
    assert (run.out / "edges.png").is_file()
