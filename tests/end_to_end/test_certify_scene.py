"""Proofs asked for by a scene: columns of tables, the summary, refusals."""

import sys

import pytest
from outputs import read_rows

from casadi_skin.runs.program import main

pytest.importorskip("flint")
pytestmark = pytest.mark.usefixtures("blank")

CHAIN = "[chain]\nsites = {sites}\nalpha = 1.0\ngamma = {gamma}\ng = -1.0\n"
FAMILY = "[family]\nmode = 1\namplitude_max = 1.0\nat = [0.2, 1.0]\n"


def scene(tmp_path, certify="true", sites=4, gamma=0.25, family=FAMILY):
    path = tmp_path / "scene.toml"
    path.write_text(CHAIN.format(sites=sites, gamma=gamma) + family + f"[accuracy]\ncertify = {certify}\n")
    return path


@pytest.mark.parametrize("certify", ["true", pytest.param('"all"', marks=pytest.mark.slow)])
def test_orbits_asked_for_or_all_have_proved_columns(tmp_path, capsys, certify):
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path, certify)), "--out", str(out)]) == 0
    rows = read_rows(out / "family.csv")
    proved = [row for row in rows if row["proved"] != ""]
    assert len(proved) == (len(rows) if certify == '"all"' else 2)
    for row in proved:
        lower, upper, Omega = float(row["Omega_lower"]), float(row["Omega_upper"]), float(row["Omega"])
        assert float(row["proved"]) == 1
        assert 0 < upper - lower < 1e-14
        assert lower - float(row["Omega_error"]) <= Omega <= upper + float(row["Omega_error"])
        assert 0 < float(row["proved_Omega_error"]) <= 10 * float(row["Omega_error"]) + 1e-15
        assert 0 < float(row["proved_radius"]) < 1e-6
    assert f"{len(proved)} of {len(proved)} orbits proved to exist" in capsys.readouterr().out


@pytest.mark.slow
def test_orbits_of_an_infinite_chain_are_proved_above_the_threshold(tmp_path, capsys):
    out = tmp_path / "out"
    family = FAMILY.replace("mode = 1", 'mode = "first"').replace("amplitude_max = 1.0", "amplitude_max = 1.2")
    path = scene(tmp_path, sites="inf", family=family)
    assert main(["run", str(path), "--out", str(out)]) == 1
    message = capsys.readouterr().err
    assert "1 of 2 orbits are not proved, the first at S = 0.2: Omega lies in the band" in message
    rows = [row for row in read_rows(out / "family.csv") if row["requested"] == "1"]
    assert [row["proved"] for row in rows] == ["0", "1"]


def test_plan_tells_what_is_proved(tmp_path, capsys):
    assert main(["check", str(scene(tmp_path, '"all"'))]) == 0
    assert "proofs        of every orbit" in capsys.readouterr().out


def test_tables_of_scenes_without_proofs_have_no_such_columns(tmp_path):
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path, "false")), "--out", str(out), "--quiet"]) == 0
    assert "proved" not in read_rows(out / "family.csv")[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"family": "[spectrum]\n"}, "[accuracy] certify: given true; accepted: with a [family]"),
        ({"gamma": 1.0}, "[accuracy] certify: given |gamma| = 1"),
        ({"certify": '"some"'}, '[accuracy] certify: given "some"; accepted: true, false or "all"'),
    ],
)
def test_proofs_that_nobody_can_give_are_refused_before_anything_is_written(tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path, **options)), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert not out.exists()


def test_numbers_with_more_digits_than_doubles_are_refused_and_decimals_are_proved(tmp_path, capsys):
    path = scene(tmp_path, gamma="0.2500000000000000000001")
    assert main(["check", str(path)]) == 2
    message = capsys.readouterr().err
    assert "[chain] gamma: given 0.2500000000000000000001; accepted: with [accuracy] certify" in message
    assert message.count("\n") == 1
    path.write_text(path.read_text().replace("certify = true", "certify = false"))
    assert main(["check", str(path)]) == 0


def test_missing_library_is_refused_with_the_extra_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    assert main(["run", str(scene(tmp_path)), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert 'python-flint is missing; install casadi-skin with the extra "certify"' in message
    assert message.count("\n") == 1


def test_orbits_that_are_not_proved_are_told_with_exit_status_1(tmp_path, capsys, monkeypatch):
    from casadi_skin.certify import certify as attempt

    monkeypatch.setattr(attempt, "MOST_FINITE_UNKNOWNS", 5)
    out = tmp_path / "out"
    assert main(["run", str(scene(tmp_path)), "--out", str(out)]) == 1
    captured = capsys.readouterr()
    assert "[accuracy] certify: mode 1: 2 of 2 orbits are not proved, the first at S = 0.2: " in captured.err
    assert "no proof that there is no orbit" in captured.err
    assert [row["proved"] for row in read_rows(out / "family.csv") if row["requested"] == "1"] == ["0", "0"]


@pytest.mark.slow
def test_changes_of_stability_have_proved_brackets_and_families_are_one_curve(tmp_path, capsys):
    path = scene(tmp_path, '"all"', sites=3, family="[family]\nmode = 2\namplitude_max = 1.0\n[stability]\n")
    path.write_text(path.read_text().replace("g = -1.0", "g = 1.0"))
    out = tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0
    (change,) = read_rows(out / "events.csv")
    lower, S, upper = (float(change[name]) for name in ("proved_S_lower", "S", "proved_S_upper"))
    assert lower < S < upper < lower + 1e-4
    assert "mode 2: proved from S = 0.0 to 1.0 in" in capsys.readouterr().out
