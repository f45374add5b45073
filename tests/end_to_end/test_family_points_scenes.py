"""Scenes that follow what leaves families, and edges of their tongues: files, and what is refused, in one line."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.runs.program import main

SCENE = """
[chain]
sites = 3
alpha = 1.0
gamma = 0.25
g = -1.0

[family]
mode = 1
amplitude_max = 2.6

[stability]

[continuation]
parameter = "S"
to = 2.62
switch = ["branch point"]
max_points = 60
curve = { parameter = "gamma", to = 0.27, further = true }

[figures]
formats = ["png"]
"""


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_what_leaves_a_family_and_the_edges_of_its_tongues_are_in_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Special points as from Python; the edge against the changes of stability of the family at its last gamma."""
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(SCENE, encoding="utf-8")
    follow, calls = SpecialPoint.curve, []

    def curve(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return follow(*arguments, **options)

    monkeypatch.setattr(SpecialPoint, "curve", curve)
    assert main(["run", str(scene), "--out", str(out)]) == 130
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
    assert len(calls) == 4  # three edges, of which the first one is in the journal
    printed = capsys.readouterr().out
    assert "branches that leave: 2" in printed
    assert "edges of tongues: 3" in printed  # two between unstable orbits
    branch = follow_family(Chain(3, 1.0, 0.25, -1.0), 1, 2.6, stability=True)
    points = [row for row in rows(out / "special_points.csv") if row["branch"] == "j1"]
    assert [(p["kind"], p["loses"]) for p in points] == [(p.kind, ", ".join(p.lost)) for p in branch.special_points]
    assert [float(p["S"]) for p in points] == pytest.approx([p.parameters["S"] for p in branch.special_points])
    edges = rows(out / "edges.csv")
    last = [row for row in edges if row["table"] == "events.csv"][-1]
    ends = {row["edge"]: float(row["S"]) for row in edges if row["table"] == "further_events.csv"}
    assert float(last["gamma"]) == 0.27
    there = follow_family(Chain(3, 1.0, 0.27, -1.0), 1, 3.0, stability=True)
    known, *_ = there.changes
    assert list(ends.values()) == pytest.approx([edge.S for edge in there.stability_diagram.further[:2]], rel=1e-9)
    assert float(last["S"]) == pytest.approx(known.S, rel=1e-10)
    assert 0.0 < float(last["S_error"]) < 1e-10
    for number, point in enumerate(points, start=1):
        leaving = rows(out / f"other_j1_{number}.csv")
        assert float(leaving[0]["S"]) == pytest.approx(float(point["S"]))
        assert (out / f"other_j1_{number}.nc").is_file()
    assert (out / "edges.png").is_file()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("further = true", "further = 1", "[continuation] curve: given {"),
        ('parameter = "S"', 'parameter = "gamma"', '[continuation] parameter: given "gamma"; accepted: "S" beside'),
        ("to = 2.62", "to = -1.0", "[continuation] to: given -1.0; accepted: a number > 0, which is S"),
        ('"branch point"', '"hopf"', '[continuation] switch: given "hopf" beside [family]; accepted: "branch point"'),
        ("to = 0.27", "to = 0.25", "[continuation] curve: given to = 0.25, where it starts; accepted: another"),
        ("to = 0.27", "to = 1.0", "[continuation] curve: given to = 1.0 for gamma; accepted: numbers between -1 and"),
        ('"gamma", to', '"gama", to', '[continuation] curve: given "gama"; did you mean "gamma"?'),
        ("max_points = 60", "at = [2.5]", "[continuation] at: given beside [family]; accepted: beside [equil"),
        ("[stability]", "", "[continuation]: given beside [family] without [stability] events; accepted: with"),
    ],
)
def test_what_is_not_accepted_beside_a_family_is_told_in_one_line(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.replace(old, new), encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
