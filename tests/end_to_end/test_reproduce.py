"""The paper recomputed from one command: pictures, the data beside them, and refusals in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import paper_data
import pytest
from figures_families import sensitivity_figure
from outputs import read_rows
from paper_data import PaperData, sensitivity, sensitivity_limit
from reproduce import FIGURES
from reproduce import main as reproduce

from casadi_skin import Chain


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows])


@pytest.mark.usefixtures("pictures")
def test_the_drawn_figures_and_their_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "paper"
    assert reproduce(["fig2", "fig1", "--out", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    tables = {"fig1_forces.csv", "fig2_spectrum.csv", "fig2_modes.csv", "fig2_sketch.csv"}
    pictures = {f"fig{k}.png" for k in (1, 2)}
    assert {path.name for path in out.iterdir()} == tables | pictures
    spectrum = read_rows(out / "fig2_spectrum.csv")
    np.testing.assert_allclose(column(spectrum, "omega"), column(spectrum, "omega_closed_form"), rtol=1e-13)
    dense = np.sqrt(np.sort(np.linalg.eigvals(Chain(24, 1.0, 0.25, 0.0).dynamical_matrix()).real))
    np.testing.assert_allclose(column(spectrum, "omega"), dense, rtol=1e-11)
    modes = column(read_rows(out / "fig2_modes.csv"), "u").reshape(2, 24)
    D = Chain(24, 1.0, 0.25, 0.0).dynamical_matrix()
    for u, omega in zip(modes, dense[[0, -1]], strict=True):
        np.testing.assert_allclose(D @ u, omega**2 * u, atol=1e-12)


@pytest.mark.slow
def test_pictures_are_the_same_bytes_again(tmp_path: Path) -> None:
    for name in ("first", "second"):
        assert reproduce(["fig2", "--out", str(tmp_path / name)]) == 0
    for path in (tmp_path / "first").iterdir():
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes()


@pytest.mark.slow
def test_sensitivity_figure_on_a_few_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"SIZES": (8, 16, 24), "SIZE_GAMMAS": (0.25, 0.7), "GAMMAS": (0.2, 0.4), "GAMMA_SIZES": (24,)}
    for name, value in few.items():
        monkeypatch.setattr(paper_data, name, value)
    _, tables = sensitivity_figure(PaperData())
    rows = tables["fig4_size"][1]
    assert [(row["gamma"], row["N"]) for row in rows] == [(g, N) for g in (0.25, 0.7) for N in (8, 16, 24)]
    for row in (*rows, *tables["fig4_gamma"][1]):
        assert row["numerical"] == pytest.approx(row["analytical"], rel=0.02)


def test_the_law_of_the_sensitivity_for_large_chains() -> None:
    assert 101**3 * sensitivity(100, 1.0, 0.7, 1.0, 1) == pytest.approx(19.308, abs=1e-3)
    for gamma, mode in ((0.25, 1), (0.7, 1), (-0.7, 2)):
        limit = sensitivity_limit(1.0, gamma, -1.0, mode)
        errors = [abs((N + 1) ** 3 * sensitivity(N, 1.0, gamma, -1.0, mode) / limit - 1.0) for N in (1000, 2000)]
        assert errors[1] < 1e-3
        assert errors[1] == pytest.approx(errors[0] / 4, rel=0.05)  # the next term is N^-2 smaller
    for gamma in (0.0, 1.0, -1.0):
        with pytest.raises(ValueError, match="gamma"):
            sensitivity_limit(1.0, gamma, 1.0, 1)


@pytest.mark.parametrize(
    ("given", "near"), [("fig8", "fig"), ("claim", "did you mean claims?"), ("7", "accepted: fig1")]
)
def test_an_unknown_target_is_refused_in_one_line(
    given: str, near: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reproduce(["fig1", given, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert repr(given) in told.err
    assert near in told.err
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("pictures")
def test_a_directory_that_holds_something_is_refused_unless_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    assert reproduce(["fig1", "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert told.endswith("holds notes.txt; accepted: an empty or new directory, or --overwrite\n")
    assert reproduce(["fig1", "--out", str(tmp_path), "--overwrite"]) == 0
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"
    assert (tmp_path / "fig1.png").exists()


@pytest.mark.usefixtures("pictures")
def test_a_computation_that_fails_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ArithmeticError("family j = 1, g = -1: lost")

    monkeypatch.setattr(paper_data, "follow_family", fail)
    assert reproduce(["fig1", "fig5", "--out", str(tmp_path)]) == 1
    told = capsys.readouterr().err
    assert "family j = 1, g = -1: lost" in told
    assert told.count("\n") == 1
    assert (tmp_path / "fig1.png").exists()
    assert not list(tmp_path.glob("fig5*"))


@pytest.mark.slow
def test_all_figures_and_the_numbers_in_their_data(tmp_path: Path) -> None:
    assert reproduce([*FIGURES, "--out", str(tmp_path)]) == 0
    for name in FIGURES:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert list(tmp_path.glob(f"{name}_*.csv"))

    profiles = read_rows(tmp_path / "fig3_profiles.csv")
    Omega = {(row["g"], row["mode"]): float(row["Omega"]) for row in profiles}
    assert Omega[("1", "24")] == pytest.approx(2.219433261085633, rel=1e-9)
    assert Omega[("-1", "1")] == pytest.approx(1.036393147166972, rel=1e-9)
    for mode in ("24", "1"):
        y = column([row for row in profiles if row["mode"] == mode], "y")
        assert y @ y == pytest.approx(0.2, rel=1e-8)

    # The mode returns after a whole period: the evolution does not share the periodic representation of the orbit.
    evolution = read_rows(tmp_path / "fig3_evolution_j1.csv")
    y = np.column_stack([column(evolution, f"y_{n}") for n in range(1, 25)])
    norm = np.linalg.norm(y, axis=1)
    minima = np.flatnonzero((norm[1:-1] < norm[:-2]) & (norm[1:-1] < norm[2:])) + 1
    quarters = np.diff(column(evolution, "t")[minima])
    assert np.mean(quarters) == pytest.approx(np.pi / Omega[("-1", "1")], abs=0.02)

    size = read_rows(tmp_path / "fig4_size.csv")
    last = next(row for row in size if row["gamma"] == "0.69999999999999996" and row["N"] == "100")
    assert 101**3 * float(last["analytical"]) == pytest.approx(19.308, abs=1e-3)
    np.testing.assert_allclose(column(size, "numerical"), column(size, "analytical"), rtol=0.02)

    multipliers = read_rows(tmp_path / "fig5_multipliers.csv")
    at_one = [row for row in multipliers if row["S"] == "1"]
    assert len(at_one) == 48
    assert max(column(at_one, "modulus")) == pytest.approx(1.1712757, abs=1e-6)
    off_axis = [row for row in multipliers if row["S"] == "3" and abs(float(row["imaginary"])) > 1e-6]
    assert max(column(off_axis, "modulus")) == pytest.approx(1.2016343, abs=1e-6)
    changes = column(read_rows(tmp_path / "fig5_changes.csv"), "S")
    assert changes[0] == pytest.approx(0.4317448, abs=1e-5)
    assert len(changes) >= 27  # windows as narrow as 0.0015 lie between S = 2.3 and 3

    gain, optimal = read_rows(tmp_path / "fig6_gain.csv"), read_rows(tmp_path / "fig6_optimal.csv")
    assert column(gain, "site_1")[-1] > 100.0
    assert max(column(gain, "site_24")) < 2.0
    assert np.all(column(optimal, "site_1_linear") <= column(optimal, "optimal") * (1 + 1e-9))
    early = column(optimal, "t") < 30.0
    kicked = np.interp(column(optimal, "t"), column(gain, "t"), column(gain, "site_1"))
    np.testing.assert_allclose(kicked[early], column(optimal, "site_1_linear")[early], rtol=0.02)

    theory = read_rows(tmp_path / "fig7_theory.csv")
    small = [row for row in theory if float(row["S"]) < 0.02]
    np.testing.assert_allclose(column(small, "shift_theory_over_shift"), 1.0, atol=0.02)
