"""Proofs asked for by a scene: columns of tables, the summary, refusals."""

import sys

import pytest
from scenes import chain, family

pytest.importorskip("flint")
pytestmark = pytest.mark.usefixtures("blank")


def scene(certify="true", sites=4, g=-1.0, families=None):
    families = families or family(at=[0.2, 1.0])
    return chain(sites, g=g) + families + f"[accuracy]\ncertify = {certify}\n"


@pytest.mark.parametrize("certify", ["true", pytest.param('"all"', marks=pytest.mark.slow)])
def test_orbits_asked_for_or_all_have_proved_columns(run, certify):
    printed = run(scene(certify)).out
    rows = run.rows("family")
    proved = [row for row in rows if row["proved"] != ""]
    assert len(proved) == (len(rows) if certify == '"all"' else 2)
    for row in proved:
        lower, upper, Omega = float(row["Omega_lower"]), float(row["Omega_upper"]), float(row["Omega"])
        assert float(row["proved"]) == 1
        assert 0 < upper - lower < 1e-14
        assert lower - float(row["Omega_error"]) <= Omega <= upper + float(row["Omega_error"])
        assert 0 < float(row["proved_Omega_error"]) <= 10 * float(row["Omega_error"]) + 1e-15
        assert 0 < float(row["proved_radius"]) < 1e-6
    assert f"{len(proved)} of {len(proved)} orbits proved to exist" in printed


@pytest.mark.slow
def test_orbits_of_an_infinite_chain_are_proved_above_the_threshold(run):
    done = run(scene(sites=float("inf"), families=family("first", 1.2, at=[0.2, 1.0])), status=1)
    assert "1 of 2 orbits are not proved, the first at S = 0.2: Omega lies in the band" in done.err
    assert [row["proved"] for row in run.rows("family") if row["requested"] == "1"] == ["0", "1"]


def test_plan_tells_what_is_proved_and_tables_without_proofs_have_no_such_columns(run):
    assert "proofs        of every orbit" in run(scene('"all"'), command="check").out
    run(scene("false"), "--quiet")
    assert "proved" not in run.rows("family")[0]


def test_missing_library_is_refused_with_the_extra_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    message = run(scene(), status=2).line
    assert 'python-flint is missing; install casadi-skin with the extra "certify"' in message


def test_orbits_that_are_not_proved_are_told_with_exit_status_1(run, monkeypatch):
    from casadi_skin.certify import certify as attempt

    monkeypatch.setattr(attempt, "MOST_FINITE_UNKNOWNS", 5)
    error = run(scene(), status=1).err
    assert "[accuracy] certify: mode 1: 2 of 2 orbits are not proved, the first at S = 0.2: " in error
    assert "no proof that there is no orbit" in error
    assert [row["proved"] for row in run.rows("family") if row["requested"] == "1"] == ["0", "0"]


@pytest.mark.slow
def test_changes_of_stability_have_proved_brackets_and_families_are_one_curve(run):
    printed = run(scene('"all"', 3, 1.0, family(2) + "[stability]\n")).out
    (change,) = run.rows("events")
    lower, S, upper = (float(change[name]) for name in ("proved_S_lower", "S", "proved_S_upper"))
    assert lower < S < upper < lower + 1e-4
    assert "mode 2: proved from S = 0.0 to 1.0 in" in printed
