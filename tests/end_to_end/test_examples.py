"""The examples, each with numbers that were computed independently."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from outputs import EXAMPLES, read_rows
from scipy.integrate import solve_ivp

from casadi_skin.runs.program import main

# (g, mode, S): Omega and the largest |multiplier|, N = 24, alpha = 1, gamma = 0.25; computed independently.
REFERENCE = {
    (-1.0, 1, 0.2): (1.036393147166972, 1.0),
    (-1.0, 1, 1.0): (1.018532435491958, 1.1712757347898),
    (-1.0, 1, 3.0): (0.765958900020734, 1.2016342571861),
    (1.0, 24, 0.2): (2.219433261085633, 1.0),
    (1.0, 24, 1.0): (2.227561552547991, 1.0314315571659),
    (1.0, 24, 3.0): (2.320036427769367, 1.0),
}


def requested_points(directory: Path) -> dict[tuple[int, float], tuple[float, float]]:
    table = [row for row in read_rows(directory / "family.csv") if row["requested"] == "1"]
    return {(int(r["mode"]), float(r["S"])): (float(r["Omega"]), float(r["max_abs_multiplier"])) for r in table}


def test_pictures_of_a_run_are_drawn(tmp_path: Path) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    chain = "[chain]\nsites = 2\nalpha = 1.0\ngamma = 0.25\ng = 1.0\n"
    scene.write_text(
        chain + "[family]\nmode = 1\namplitude_max = 0.1\n[figures]\nformats = ['svg', 'png']\n", encoding="utf-8"
    )
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 0
    assert (out / "frequency.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (out / "frequency.svg").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_softening_end_breather(tmp_path: Path) -> None:
    assert main(["run", str(EXAMPLES / "softening_end_breather.toml"), "--out", str(tmp_path / "out")]) == 0
    points = requested_points(tmp_path / "out")
    assert len(points) == 3
    for (mode, S), values in points.items():
        np.testing.assert_allclose(values, REFERENCE[-1.0, mode, S], rtol=0, atol=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "g"), [("hardening", 1.0), ("softening", -1.0)])
def test_twelve_families_of_figure_3(name: str, g: float, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    assert main(["run", str(EXAMPLES / f"families_{name}.toml"), "--out", str(tmp_path / "out")]) == 0
    points = requested_points(tmp_path / "out")
    assert len(points) == 24
    known = {(mode, S): values for (sign, mode, S), values in REFERENCE.items() if sign == g}
    for place, (Omega, multiplier) in known.items():
        assert abs(points[place][0] - Omega) < 1e-10
        assert abs(points[place][1] - multiplier) < 1e-8
    with xarray.open_dataset(tmp_path / "out" / "family.nc", engine="scipy") as data:
        assert float(data.trivial_deviation.max()) < 1e-10
        shift = np.sign(data.Omega_shift.values)
        np.testing.assert_array_equal(shift, g)


FEWER = {
    "mode = [1, 2, ": "mode = [", "amplitude_max = 2.0": "amplitude_max = 0.2", "at = [1.0]": "at = [0.2]",
    "amplitude_max = 20.0": "amplitude_max = 4.0", "at = [1.0, 10.0]": "at = [4.0]", "S = 10.0": "S = 4.0",
}  # fmt: skip


def fput_forces(y: np.ndarray) -> np.ndarray:
    d = np.diff(y, prepend=0.0, append=0.0)
    return np.diff(d + d**3)


def pendulum_forces(y: np.ndarray) -> np.ndarray:
    return np.asarray(-np.sin(y) + 0.2 * np.diff(np.diff(y, prepend=0.0, append=0.0)))


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
@pytest.mark.parametrize("fewer", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["fewer", "all"])
@pytest.mark.parametrize(
    ("name", "forces"), [("fput_modes", fput_forces), ("pendulum_chain", pendulum_forces)], ids=["fput", "pendula"]
)
def test_lattices_of_ones_own(
    name: str, forces: Callable[[np.ndarray], np.ndarray], fewer: bool, tmp_path: Path
) -> None:
    """Orbits at requested points come back to themselves in an integration of equations written anew."""
    xarray = pytest.importorskip("xarray")
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8").replace('"models/', f'"{EXAMPLES}/models/')
    for old, new in FEWER.items() if fewer else ():
        text = text.replace(old, new)
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out")]) == 0
    with xarray.open_dataset(tmp_path / "out" / "family.nc", engine="scipy") as data:
        for place in np.flatnonzero(data.requested.values):
            y = data.profile.values[place]
            assert y @ y == pytest.approx(float(data.S[place]), rel=1e-12)
            n, period = y.size, 2 * np.pi / float(data.Omega[place])
            flow = solve_ivp(
                lambda t, s, n=n: [*s[n:], *forces(s[:n])], (0.0, period), [*y, *np.zeros(n)], method="DOP853",
                rtol=1e-12, atol=1e-13,
            )  # fmt: skip
            allowed = 1e-7 * max(1.0, float(data.max_abs_multiplier[place]))
            np.testing.assert_allclose(flow.y[:, -1], [*y, *np.zeros(n)], atol=allowed)
    if name == "pendulum_chain":
        table = [[float(value) for value in row.values()] for row in read_rows(tmp_path / "out" / "dynamics.csv")]
        np.testing.assert_allclose(table[100], [table[100][0], *table[0][1:]], atol=1e-6)  # a period later
        assert np.ptp([row[1] for row in table]) < 1e-9
