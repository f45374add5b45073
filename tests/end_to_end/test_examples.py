"""The examples, each with numbers that were computed independently."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from outputs import EXAMPLES
from scenes import Runs, chain, family
from scipy.integrate import solve_ivp

# (g, mode, S): Omega and the largest |multiplier|, N = 24, alpha = 1, gamma = 0.25; computed independently.
REFERENCE = {
    (-1.0, 1, 0.2): (1.036393147166972, 1.0),
    (-1.0, 1, 1.0): (1.018532435491958, 1.1712757347898),
    (-1.0, 1, 3.0): (0.765958900020734, 1.2016342571861),
    (1.0, 24, 0.2): (2.219433261085633, 1.0),
    (1.0, 24, 1.0): (2.227561552547991, 1.0314315571659),
    (1.0, 24, 3.0): (2.320036427769367, 1.0),
}


def check_points(run: Runs, g: float, count: int, allowed: tuple[float, float]) -> None:
    """Requested points of a run against those of the table."""
    found = run.columns("family", "mode", "S", "Omega", "max_abs_multiplier", requested="1")
    assert len(found[0]) == count
    points = {(int(mode), S): values for mode, S, *values in zip(*found, strict=True)}
    for (sign, mode, S), known in REFERENCE.items():
        if sign == g:
            np.testing.assert_array_less(np.abs(np.subtract(points[mode, S], known)), allowed)


def test_pictures_of_a_run_are_drawn(run: Runs) -> None:
    run(chain(2, g=1.0) + family(1, 0.1) + "[figures]\nformats = ['svg', 'png']\n", "--quiet")
    assert (run.out / "frequency.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (run.out / "frequency.svg").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_softening_end_breather(run: Runs) -> None:
    run(EXAMPLES / "softening_end_breather.toml")
    check_points(run, -1.0, 3, (2e-9, 2e-9))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "g"), [("hardening", 1.0), ("softening", -1.0)])
def test_twelve_families_of_figure_3(name: str, g: float, run: Runs) -> None:
    xarray = pytest.importorskip("xarray")
    run(EXAMPLES / f"families_{name}.toml")
    check_points(run, g, 24, (1e-10, 1e-8))
    with xarray.open_dataset(run.out / "family.nc", engine="scipy") as data:
        assert float(data.trivial_deviation.max()) < 1e-10
        np.testing.assert_array_equal(np.sign(data.Omega_shift.values), g)


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
def test_lattices_of_ones_own(name: str, forces: Callable[[np.ndarray], np.ndarray], fewer: bool, run: Runs) -> None:
    """Orbits at requested points come back to themselves in an integration of equations written anew."""
    xarray = pytest.importorskip("xarray")
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8").replace('"models/', f'"{EXAMPLES}/models/')
    for old, new in FEWER.items() if fewer else ():
        text = text.replace(old, new)
    run(text)
    with xarray.open_dataset(run.out / "family.nc", engine="scipy") as data:
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
        table = [[float(value) for value in row.values()] for row in run.rows("dynamics")]
        np.testing.assert_allclose(table[100], [table[100][0], *table[0][1:]], atol=1e-6)  # a period later
        assert np.ptp([row[1] for row in table]) < 1e-9
