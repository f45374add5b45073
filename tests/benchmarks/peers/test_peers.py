"""The same family by this package, AUTO-07p and scipy's solve_bvp, side by side in one run; errors asserted, not times.

Run with `pytest -m benchmark -s tests/benchmarks/peers`, one thread (OMP_NUM_THREADS=1). Peers that are not installed
are skipped. All follow j = 1, g = -1 from the linear mode to S = 3 with points exactly at S = 0.2, 1 and 3, asked for
an Omega good to 1e-8 there. Errors are taken at every point, against this package at tolerance 1e-12, itself held to
digits computed elsewhere. Times are of a processor, as multiples of a dense 193 x 193 solve timed before and after.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.util import find_spec as installed
from pathlib import Path

import auto_family
import jaxcont_family
import numpy as np
import pytest
import solve_bvp_family
from auto_equations import Formulation
from family_case import Family, FamilyCase, Timed, timed, unit_seconds
from our_family import VARIANTS, our_family, reference

pytestmark = pytest.mark.benchmark

REPEATS = {24: 7, 48: 3}  # counted runs by length of the chain
ASKED = 1e-8  # error of Omega at the S asked for; settings are the cheapest that round to it
PACKAGES = ("casadi", "numpy", "scipy", "bifpy", "jaxcont", "jax")
UNSTABLE = 1.01  # largest |multiplier| from which its error is compared: nearer 1 it is the root of that of the flow
OUR_TOLERANCE = 1e-8
HEADING = (
    f"{'program':<50} {'points':>6} {'solves: median, range':>23} {'a point':>8}   "
    "Omega at S = 0.2, 1, 3, worst             multiplier at 3, worst, of stable orbits"
)


@dataclass(frozen=True)
class Errors:
    """Of Omega at the S asked for and the worst of all points; the same of the largest |multiplier| at the last S.

    `stable_multiplier` is the largest distance from 1 at an orbit that is stable.
    """

    Omega: tuple[float, ...]
    worst: float
    multiplier: float | None = None
    worst_multiplier: float | None = None
    stable_multiplier: float | None = None


def errors(case: FamilyCase, family: Family) -> Errors:
    moving = family.S > 1e-9  # the linear mode itself is no point of comparison
    exact = reference(case, family.S[moving])
    assert exact.multiplier is not None
    of_omega = family.Omega[moving] - exact.Omega
    asked = [int(np.argmin(abs(exact.S - S))) for S in case.at]
    assert max(abs(family.S[moving][asked] - case.at)) < 1e-6, "left the family"
    at = tuple(float(of_omega[i]) for i in asked)
    if family.multiplier is None:
        return Errors(at, float(max(abs(of_omega))))
    of_multiplier = family.multiplier[moving] - exact.multiplier
    unstable, stable = exact.multiplier > UNSTABLE, exact.multiplier == 1.0
    parts = (float(np.max(abs(of_multiplier[which]), initial=0.0)) for which in (unstable, stable))
    return Errors(at, float(max(abs(of_omega))), float(of_multiplier[asked[-1]]), *parts)


@dataclass
class Table:
    """Rows in the order in which they were measured."""

    case: FamilyCase
    lines: list[str] = field(default_factory=list)

    def add(self, name: str, follow: Callable[[], Family]) -> Errors:
        measured = timed(follow, REPEATS[self.case.sites])
        found = errors(self.case, measured.family)
        self.lines.append(self.line(name, measured, found))
        print(f"\n{self.lines[-1]}")
        assert max(map(abs, found.Omega)) < 1.5 * ASKED
        return found

    @staticmethod
    def line(name: str, measured: Timed, found: Errors) -> str:
        solves, points = measured.solves, len(measured.family.S)
        cost = f"{np.median(solves):.0f}, {solves.min():.0f}-{solves.max():.0f}"
        at = " ".join(f"{value:8.1e}" for value in (*found.Omega, found.worst))
        text = f"{name:<50} {points:>6} {cost:>23} {np.median(solves) / points:>8.1f}   {at}"
        of_multiplier = (found.multiplier, found.worst_multiplier, found.stable_multiplier)
        return text + "  " + " ".join(f"{value:8.1e}" for value in of_multiplier if value is not None)


@pytest.fixture(scope="module", params=list(REPEATS), ids=[f"N{sites}" for sites in REPEATS])
def table(request: pytest.FixtureRequest) -> Iterator[Table]:
    """One table for each length of the chain, printed when all programs have been through it."""
    table = Table(FamilyCase(request.param))
    yield table
    print(
        "\n\n"
        + "\n".join(
            [
                f"N = {request.param}, {REPEATS[request.param]} repeats; a solve takes {1e3 * unit_seconds():.3f} ms",
                "; ".join(f"{name} {version(name)}" for name in PACKAGES if installed(name)),
                HEADING,
                *table.lines,
            ]
        )
    )


def test_reference_against_digits_computed_elsewhere() -> None:
    case = FamilyCase()
    exact = reference(case, np.array(case.at))
    assert exact.Omega == pytest.approx([1.036393147166972, 1.018532435491958, 0.765958900020734], rel=1e-13)
    assert exact.multiplier[1:] == pytest.approx([1.171275734790, 1.2016342572], abs=2e-10)


@pytest.mark.parametrize("stability", [False, True], ids=["without", "with"])
def test_ours_with_fewer_points(table: Table, stability: bool) -> None:
    name = "this, newton, series"
    follow = our_family(table.case, OUR_TOLERANCE, VARIANTS[name], stability, fewer=True)
    found = table.add(f"{name}, fewer points{', multipliers' if stability else ''}", follow)
    assert found.worst < 1e-8
    assert found.worst_multiplier is None or found.worst_multiplier < 1e-7
    assert not found.stable_multiplier


@pytest.mark.parametrize("stability", [False, True], ids=["without", "with"])
@pytest.mark.parametrize("name", VARIANTS)
def test_ours(table: Table, name: str, stability: bool) -> None:
    follow = our_family(table.case, OUR_TOLERANCE, VARIANTS[name], stability)
    found = table.add(f"{name}, {OUR_TOLERANCE:g}{', multipliers' if stability else ''}", follow)
    assert found.worst < 1e-8
    assert found.worst_multiplier is None or found.worst_multiplier < 1e-7
    assert not found.stable_multiplier


@pytest.mark.parametrize("points", ["few", "many"])
@pytest.mark.parametrize(
    "formulation", [f for f in Formulation if f is not Formulation.PHYSICAL], ids=lambda value: value.name.lower()
)
def test_auto(table: Table, formulation: Formulation, points: str, tmp_path: Path) -> None:
    if message := auto_family.missing():
        pytest.skip(message)
    program = auto_family.AutoProgram(tmp_path, table.case, formulation)
    settings = (auto_family.BEST if points == "few" else auto_family.MANY_POINTS)[formulation]
    found = table.add(f"AUTO-07p, {formulation.value}, {points} points", lambda: program.follow(settings))
    assert found.worst < 3e-8
    assert found.worst_multiplier is None or found.worst_multiplier < 1e-6


def test_multipliers_of_auto_in_physical_coordinates(tmp_path: Path) -> None:
    """Once, not timed: N = 48, gamma = 0.6, stable orbits to S = 0.2, in the gauge and in physical coordinates."""
    if message := auto_family.missing():
        pytest.skip(message)
    case, of_stable = FamilyCase(48, (0.1, 0.2), gamma=0.6), []
    for formulation in (Formulation.PERIOD, Formulation.PHYSICAL):
        program = auto_family.AutoProgram(tmp_path / formulation.name, case, formulation)
        found = errors(case, program.follow(auto_family.BEST[formulation]))
        print(f"\nN = 48, gamma = 0.6, AUTO-07p, {formulation.value}: {found}")
        assert max(map(abs, found.Omega)) < ASKED
        of_stable.append(found.stable_multiplier or 0.0)
    assert of_stable[0] < 1e-6
    assert of_stable[1] > 1e3 * of_stable[0]  # digits lost to the envelope, not to the discretisation


def test_jaxcont(table: Table) -> None:
    if message := jaxcont_family.missing():
        pytest.skip(message)
    found = table.add("JaxCont, odd cosines", jaxcont_family.JaxContWalk(table.case).family)
    assert found.worst < 3e-8


@pytest.mark.parametrize("name", solve_bvp_family.BEST)
def test_solve_bvp(table: Table, name: str) -> None:
    walk = solve_bvp_family.BvpWalk(table.case, solve_bvp_family.BEST[name])
    found = table.add(f"solve_bvp, {name}", lambda: walk.family(multipliers=False))
    assert found.worst < 3e-8


def test_solve_bvp_with_multipliers(table: Table) -> None:
    settings = solve_bvp_family.BEST["S, longest steps"]
    walk = solve_bvp_family.BvpWalk(table.case, settings)
    found = table.add("solve_bvp and solve_ivp, S, longest steps", lambda: walk.family(multipliers=True))
    assert found.worst < 3e-8
    assert abs(found.multiplier or 0.0) < 5e-7
