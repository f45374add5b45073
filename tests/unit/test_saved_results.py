"""Results in files: what is read is what was saved, and what is computed from it has the same bits."""

from __future__ import annotations

import functools
from contextlib import suppress
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import Program

from casadi_skin import (
    Bond,
    BoundaryValueProblem,
    Branch,
    Chain,
    Lattice,
    OdeModel,
    Site,
    find_equilibrium,
    find_orbit,
    follow_family,
    read_result,
    save_result,
    simulate,
)
from casadi_skin.certify.certificate import ProvedStability
from casadi_skin.model.ode import OdeModel as Model
from casadi_skin.results.saving import FORMAT
from casadi_skin.results.store import framed

X, Y, MU, NU = (ca.SX.sym(name) for name in ("x", "y", "mu", "nu"))
VAN_DER_POL = OdeModel("van der Pol", ca.vertcat(X, Y), ca.vertcat(Y, MU * (1 - X**2) * Y - X), MU)
HOPF = OdeModel(
    "Hopf", ca.vertcat(X, Y), ca.vertcat(MU * X - Y - X * (X**2 + NU * Y**2), X + MU * Y - Y * (X**2 + Y**2)),
    ca.vertcat(MU, NU), nominal=(-0.5, 1.0),
)  # fmt: skip


def again(result: Any, folder: Path) -> Any:
    """A result, saved and read."""
    return read_result(save_result(result, folder / "result.skin"))


def same(one: Branch, two: Branch) -> None:
    """Whether two branches have the same bits."""
    assert len(one) == len(two) > 0
    assert (one.reason, one.located, one.misses) == (two.reason, two.located, two.misses)
    for a, b in zip(one.solutions, two.solutions, strict=True):
        assert type(a) is type(b)
        assert a.point.z.tobytes() == b.point.z.tobytes()
        assert a.point.tangent.tobytes() == b.point.tangent.tobytes()
        assert (a.point.error, a.exact, a.parameters) == (b.point.error, b.exact, b.parameters)


@functools.cache
def family() -> Branch:
    return follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.01, stability=True, tolerance=1e-4, at=[0.005])


@functools.cache
def cycle() -> Any:
    guess = (np.linspace(0, 6.3, 30), np.stack([2 * np.cos(np.linspace(0, 6.3, 30))] * 2))
    return find_orbit(VAN_DER_POL, guess, 6.3, parameters={"mu": 0.2}, tolerance=1e-4, corrector="newton")


def test_a_family_goes_on_from_a_file_as_if_it_had_not_been_saved(tmp_path: Path) -> None:
    read = again(family(), tmp_path)
    same(family(), read)
    one, two = family().at(S=0.007), read.at(S=0.007)
    assert one.point.z.tobytes() == two.point.z.tobytes()
    assert one.floquet().multipliers.tobytes() == two.floquet().multipliers.tobytes()
    assert [o.known_floquet is not None for o in read.orbits] == [True] * len(read)


def test_an_orbit_is_followed_from_a_file_as_if_it_had_not_been_saved(tmp_path: Path) -> None:
    read = again(cycle(), tmp_path)
    assert read.period == cycle().period
    one, two = (orbit.follow("mu", 0.4, max_points=4) for orbit in (cycle(), read))
    same(one, two)
    same(one, again(one, tmp_path))


def test_a_file_is_a_file_in_a_directory(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^path: given .*, which is a directory; accepted: the path of a file$"):
        family().save(tmp_path)
    with pytest.raises(ValueError, match=r"^path: given .*, in no directory; accepted: a file in a directory that is"):
        family().save(tmp_path / "nowhere" / "result.skin")


@pytest.mark.slow
def test_special_points_lead_on_from_a_file(tmp_path: Path) -> None:
    rest = find_equilibrium(HOPF, [0.0, 0.0])
    branch = rest.follow("mu", 0.5)
    read = again(branch, tmp_path)
    same(branch, read)
    assert again(rest, tmp_path).spectrum.values.tobytes() == rest.spectrum.values.tobytes()
    (point,) = branch.special_points
    cycles = point.follow("mu", 0.3)
    same(cycles, again(branch.special_points[0], tmp_path).follow("mu", 0.3))
    later = again(cycles, tmp_path).solutions[-1].follow("nu", 1.5)
    same(cycles.solutions[-1].follow("nu", 1.5), later)
    curve = point.curve("nu", 2.0)
    same(curve, again(curve, tmp_path))
    same(curve, again(branch, tmp_path).special_points[0].curve("nu", 2.0))


@pytest.mark.slow
def test_other_problems_lead_on_from_a_file(tmp_path: Path) -> None:
    z, p, T = ca.SX.sym("z", 2), ca.SX.sym("p"), ca.SX.sym("T")
    bratu = OdeModel("Bratu", z, ca.vertcat(z[1], -p * ca.exp(z[0])), ca.vertcat(p, T))
    problem = BoundaryValueProblem(
        bratu, [bratu.start(z[0]), bratu.end(z[0])], interval=(0.0, T), parameters={"p": 1.0, "T": 1.0}
    )
    solution = problem.solve([0.1, 0.0])
    same(solution.follow("p", 4.0), again(solution, tmp_path).follow("p", 4.0))
    ring = Lattice(6, [Site("a")], [Bond("a", "a", (1,), "d + beta*d^3")], "periodic", {"beta": 1.0})
    modes = follow_family(ring, "last", 0.3)
    read = again(modes, tmp_path)
    same(modes, read)
    followed = modes.orbits[-1].follow("beta", 1.2)
    same(followed, read.orbits[-1].follow("beta", 1.2))
    same(followed, again(followed, tmp_path))


def test_numbers_beside_branches_come_back(tmp_path: Path) -> None:
    evolution = simulate(VAN_DER_POL, [2.0, 0.0], np.linspace(0, 1, 5), parameters={"mu": 1.0})
    read = again(evolution, tmp_path)
    assert read.states.tobytes() == evolution.states.tobytes()
    assert dict(read.parameters) == {"mu": 1.0}
    proved = ProvedStability("unstable", np.zeros((0, 2)), np.zeros(0, dtype=np.int64), 0.5 + 0.1j, 1e-9, 1.0)
    assert again(proved, tmp_path).exponent == proved.exponent
    floquet = cycle().floquet()
    assert again(floquet, tmp_path).multipliers.tobytes() == floquet.multipliers.tobytes()


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    for thing in (1.0, [1.0], Chain(2, 1.0, 0.0, 1.0), object()):
        with pytest.raises(ValueError, match="accepted: "):
            save_result(thing, tmp_path / "no.skin")
    assert not list(tmp_path.iterdir())


def test_programs_are_refused_with_the_reason(tmp_path: Path) -> None:
    x = ca.MX.sym("x", 1)
    twice = Program(ca.Function("twice", [x], [2 * x]))
    model = Model("program", x, -twice(x))
    evolution = simulate(VAN_DER_POL, [2.0, 0.0], [0.0, 0.1], parameters={"mu": 1.0})
    object.__setattr__(evolution.equations, "model", model)
    with pytest.raises(ValueError, match="program: cannot be saved"):
        evolution.save(tmp_path / "no.skin")


def refusal(data: bytes, folder: Path) -> str:
    path = folder / "damaged.skin"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="accepted: ") as caught:
        read_result(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: not a result saved by casadi_skin: ")
    assert message.isprintable()
    assert len(message) < 500
    return message


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    data = cycle().save(tmp_path / "orbit.skin").read_bytes()
    for place in np.linspace(0, len(data) - 1, 60).astype(int):
        flipped = bytearray(data)
        flipped[place] ^= 1
        refusal(bytes(flipped), tmp_path)
    for size in (0, 10, len(data) - 1):
        refusal(data[:size], tmp_path)
    refusal(data + data, tmp_path)
    with pytest.raises(ValueError, match="no such file"):
        read_result(tmp_path / "missing.skin")


names = st.sampled_from(["object", "shared", "array", "tuple", "map", "enum", "point", "refinement", "Orbit", "Chain",
                         "End", "<f8", "|O", "Popen", "os", "model", "family", "space"])  # fmt: skip
values = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 9) | st.floats() | names | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=3),
    max_leaves=12,
)


@given(values, st.lists(values, max_size=2))
def test_whatever_a_file_with_the_right_checksum_says_it_is_data_or_refused(
    tmp_path_factory: pytest.TempPathFactory, result: Any, shared: list[Any]
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.skin"
    saved = {"format": FORMAT, "version": "0", "shared": shared, "result": result}
    path.write_bytes(framed(msgspec.msgpack.encode(saved)))
    with suppress(ValueError):
        read_result(path)


@pytest.mark.slow
def test_diagrams_and_curves_of_orbits_lead_on_from_a_file(tmp_path: Path) -> None:
    x, y, z, alpha, beta = (ca.SX.sym(name) for name in ("x", "y", "z", "alpha", "beta"))
    model = OdeModel(
        "adaptx", ca.vertcat(x, y, z), ca.vertcat(y, z, -alpha * z - beta * y - x + x**2), ca.vertcat(alpha, beta),
        nominal=(2.0, 1.0),
    )  # fmt: skip
    diagram = find_equilibrium(model, [0.0, 0.0, 0.0]).follow("alpha", 0.6).follow_all(depth=1)
    read = again(diagram, tmp_path)
    for one, two in zip(diagram, read, strict=True):
        same(one, two)
    (doubling,) = (p for p in diagram.special_points if p.kind == "period doubling")
    (found,) = (p for p in read.special_points if p.kind == "period doubling")
    curve = doubling.curve("beta", 1.1, max_points=3)
    same(curve, found.curve("beta", 1.1, max_points=3))
    same(curve, again(curve, tmp_path))
    assert len(diagram.to_dataframe()) == sum(map(len, diagram))
    assert "period doubling" in str(diagram)
