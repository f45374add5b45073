"""Models M x' = f with a singular mass matrix, against closed forms and against the same models as ODEs."""

from __future__ import annotations

import pickle
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import numpy as np
import pytest
from c_programs import COMPILERS, Library
from scenes import Cli, Runs, column, table
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.special import ellipk

from casadi_skin import (
    BoundaryValueProblem,
    EquilibriumError,
    EvolutionError,
    OdeModel,
    evolve,
    export_c,
    find_equilibrium,
    find_orbit,
    read_model,
    save_model,
    simulate,
)

V = 1e3  # another unit


def symbols(names: str) -> list[ca.SX]:
    return [ca.SX.sym(name) for name in names.split()]


def circuit(time: float = 1.0, volt: float = 1.0, **fields: Any) -> OdeModel:
    """Van der Pol's oscillator: a coil, a capacitor and an element with current z = v^3/3 - mu v, in other units."""
    v, i, z, mu = symbols("v i z mu")
    u = v / volt
    rhs = [(-i - z) / time * volt, u / time, z - (u**3 / 3 - mu * u)]
    return OdeModel("circuit", [v, i, z], rhs, mu, mass=np.diag([1.0, 1.0, 0.0]), nominal=[1.0], **fields)


def plain_circuit() -> OdeModel:
    v, i, mu = symbols("v i mu")
    return OdeModel("plain circuit", [v, i], [-i - (v**3 / 3 - mu * v), v], mu, nominal=[1.0])


CYCLE_PERIOD = 6.663286859323  # of van der Pol's equation at mu = 1 (as 6.6632868593231301)


def colpitts() -> tuple[OdeModel, OdeModel]:
    """An oscillator in all node voltages and the currents of coil and source, and in three states; at I = 2 R a Hopf.

    Its linear part with C1 = C2 = L = 1 and thermal voltage 1 is s^3 + R s^2 + 2 s + I = 0.
    """
    vcc, vn, vc, ve, il, iv, bias = symbols("vcc vn vc ve il iv I")
    R, supply, saturation = np.sqrt(2.0) / 1.4, 5.0, 1e-3
    ic = saturation * ca.exp(-ve)
    rows = [
        ([0, 0, 0, 0, 0, 0], iv + (vcc - vn) / R),
        ([0, 0, 0, 0, 0, 0], (vcc - vn) / R - il),
        ([0, 0, 1, -1, 0, 0], il - ic),
        ([0, 0, -1, 2, 0, 0], ic - bias),
        ([0, 0, 0, 0, 1, 0], vn - vc),
        ([0, 0, 0, 0, 0, 0], vcc - supply),
    ]
    nodes = OdeModel(
        "colpitts", [vcc, vn, vc, ve, il, iv], [f for _, f in rows], bias, mass=np.array([m for m, _ in rows], float),
        nominal=[1.5],
    )  # fmt: skip
    x, y, i = symbols("x y i")
    ic = saturation * ca.exp(-y)
    plain = OdeModel("plain", [x, y, i], [i - ic, i - bias, supply - R * i - x - y], bias, nominal=[1.5])
    return nodes, plain


def pendulum(pump: float, energy: float = 0.0) -> OdeModel:
    """A pendulum in Cartesian coordinates, with a force along its velocity where its energy is not that wanted."""
    x, y, u, w, tension = symbols("x y u w T")
    H = (u**2 + w**2) / 2 + y
    push = -pump * (H - energy)
    rhs = [u, w, -tension * x + push * u, -tension * y - 1.0 + push * w, x**2 + y**2 - 1.0]
    return OdeModel(
        "pendulum", [x, y, u, w, tension], rhs, mass=np.diag([1.0, 1, 1, 1, 0]), hamiltonian=None if pump else H
    )


def swing(angle: float) -> Any:
    """A guess of the pendulum's motion to an angle."""
    period = 4.0 * ellipk(np.sin(angle / 2.0) ** 2)

    def at(t: float) -> list[float]:
        phase = 2.0 * np.pi * t / period
        q, rate = angle * np.cos(phase), -angle * 2.0 * np.pi / period * np.sin(phase)
        return [np.sin(q), -np.cos(q), rate * np.cos(q), rate * np.sin(q), np.cos(q) + rate**2]

    return at, period


def test_a_regular_mass_matrix_is_an_inverse() -> None:
    x, y, m = symbols("x y m")
    model = OdeModel("inverse", [x, y], [y, -x], m, mass=[[m, 1.0], [0.0, 2.0]])
    rates = np.array(model.vector_field(0.0, [0.3, -0.7], [4.0])).ravel()
    assert rates == pytest.approx(np.linalg.solve([[4.0, 1.0], [0.0, 2.0]], [-0.7, -0.3]), rel=1e-15)


def test_rows_that_depend_on_each_other_leave_an_algebraic_equation() -> None:
    v, w, C = symbols("v w C")
    model = OdeModel("floating", [v, w], [-v, w - v**3], C, mass=[[C, -C], [-C, C]])  # both sum to 0 = w - v - v^3
    start = [1.0, 0.0]
    found = simulate(model, start, np.linspace(0.0, 1.0, 11), parameters={"C": 2.0})
    v, w = found.states.T
    assert np.max(np.abs(w - v - v**3)) < 1e-10
    assert found.states[0] @ [1, -1] == pytest.approx(1.0)  # the charge of the start
    # C (v - w)' = -v with v - w = -v^3: 6 v v' = 1, v^2 = v0^2 + t/3 for C = 2
    assert v**2 == pytest.approx(v[0] ** 2 + found.t / 3.0, rel=1e-8)


@pytest.mark.parametrize("decay", [None, 1e-3, 1.0, 1e3])
def test_cycle_of_a_circuit_whatever_the_rate(decay: float | None) -> None:
    model = circuit(decay=decay)
    orbit = find_orbit(model, lambda t: [2.0 * np.cos(t), 2.0 * np.sin(t), 0.0], CYCLE_PERIOD)
    assert orbit.period == pytest.approx(CYCLE_PERIOD, abs=max(2e-12, orbit.error))
    own = find_orbit(plain_circuit(), lambda t: [2.0 * np.cos(t), 2.0 * np.sin(t)], CYCLE_PERIOD).floquet()
    found = orbit.floquet()
    assert found.multipliers.size == 2
    assert found.trivial == 1
    assert abs(found.others[0] - own.others[0]) <= found.other_errors[0] + own.other_errors[0]
    assert found.trivial_deviation <= found.allowed_deviation
    by_flow = orbit.floquet(flow="cvodes")
    assert by_flow.others == pytest.approx(own.others, abs=1e-7)


def test_branch_of_a_circuit_has_the_points_of_its_ode() -> None:
    start = find_equilibrium(circuit(), [0.1, 0.1, 0.1], parameters={"mu": -0.5})
    assert start.eigenvalues == pytest.approx(np.roots([1.0, 0.5, 1.0]))
    (hopf,) = start.follow("mu", 1.0).special_points
    assert hopf.kind == "hopf"
    assert abs(hopf.parameters["mu"]) < 1e-12
    cycles = hopf.follow("mu", 1.0)
    assert cycles.at(mu=1.0).period == pytest.approx(CYCLE_PERIOD, rel=1e-9)
    assert not [point for point in cycles.special_points if point.kind != "hopf"]


def test_units_of_time_and_voltage() -> None:
    model, guess = circuit(time=1e-9, volt=V), lambda t: [2.0 * V * np.cos(1e9 * t), 2.0 * V * np.sin(1e9 * t), 0.0]
    start = find_equilibrium(model, [0.0, 0.0, 0.0], parameters={"mu": -0.5})
    assert 1e9 * start.eigenvalues / 1e18 == pytest.approx(np.roots([1.0, 0.5, 1.0]))
    orbit = find_orbit(model, guess, 1e-9 * CYCLE_PERIOD)
    assert 1e9 * orbit.period == pytest.approx(CYCLE_PERIOD, rel=1e-11)
    assert orbit.floquet().multipliers.size == 2


def test_circuit_in_SI_units() -> None:
    """Colpitts' oscillator of Kennedy (1994) in volts, amperes and seconds: a Hopf point at I = R VT (C1 + C2)/L."""
    supply, top, collector, emitter, coil, battery, bias = symbols("supply top collector emitter coil battery bias")
    R, C, L, thermal, saturation = 35.0, 54e-9, 98.5e-6, 0.026, 1e-14
    through, resistor = saturation * ca.exp(-emitter / thermal), (supply - top) / R
    rhs = [battery + resistor, resistor - coil, coil - through, through - bias, top - collector, supply - 5.0]
    mass = np.zeros((6, 6))
    mass[2:4, 2:4], mass[4, 4] = [[C, -C], [-C, 2 * C]], L
    model = OdeModel("SI", [supply, top, collector, emitter, coil, battery], rhs, bias, mass=mass, nominal=[8e-4])
    start = find_equilibrium(model, [5.0, 5.0, 5.0, -0.65, 1e-3, -1e-3])
    (hopf,) = start.follow("bias", 1.5e-3).special_points
    expected = R * thermal * 2 * C / L
    assert hopf.parameters["bias"] == pytest.approx(expected, rel=1e-12)
    assert hopf.frequency == pytest.approx(np.sqrt(2.0 / (L * C)), rel=1e-9)
    cycle = hopf.follow("bias", 2.5 * expected, stability=True)
    assert [point.kind for point in cycle.special_points] == ["period doubling"]


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("seed", range(16))
def test_linear_equations_of_any_index_in_any_units(seed: int, sparse: bool) -> None:
    """P diag(1, N) Q x' = P diag(J, 1) Q (x - x0) with nilpotent N (Weierstrass): the eigenvalues are those of J."""
    generator = np.random.default_rng(seed)
    free, blocks = int(generator.integers(1, 5)), generator.integers(1, 4, size=int(generator.integers(1, 4)))
    nilpotent = block_diag(*(np.eye(size, k=1) for size in blocks))
    J, n = generator.normal(size=(free, free)), free + len(nilpotent)
    P, Q = generator.normal(size=(2, n, n))
    if sparse:
        P, Q = (np.eye(n)[generator.permutation(n)] + (generator.random((n, n)) < 0.1) * each for each in (P, Q))
    units, rows = 10.0 ** generator.integers(-6, 7, size=(2, n))
    time = 10.0 ** float(generator.integers(-6, 7))
    x = ca.SX.sym("x", n)
    rhs = ca.DM(rows[:, None] * (P @ block_diag(J, np.eye(len(nilpotent))) @ Q) / units) @ (x - ca.DM(units))
    mass = time * rows[:, None] * (P @ block_diag(np.eye(free), nilpotent) @ Q) / units
    model = OdeModel("linear", x, rhs, mass=mass)
    assert model.implicit is not None
    assert len(model.implicit.conditions) == n - free
    found = find_equilibrium(model, 1.1 * units)
    assert found.state == pytest.approx(units, rel=1e-9)
    expected = np.sort_complex(np.linalg.eigvals(J))
    assert time * np.sort_complex(found.eigenvalues) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("others", range(6))
def test_exponentials_hide_nothing(others: int) -> None:
    """A diode in V, A and s beside other capacitors: its current at the states at which entries are compared."""
    v, charged, supply = symbols("v charged supply")
    beside = [ca.SX.sym(f"w{k}") for k in range(others)]
    R, C, saturation, thermal = 1e3, 1e-9, 1e-14, 0.02585
    rhs = [
        *((supply - w) / R for w in beside),
        (supply - v) / R - saturation * (ca.exp(v / thermal) - 1.0) - (v - charged) / R,
        (v - charged) / R,
    ]
    model = OdeModel("diode", [*beside, v, charged], rhs, supply, mass=np.diag([*[C] * others, 0.0, C]), nominal=[2.0])
    found = find_equilibrium(model, [1.0] * others + [0.6, 0.6])
    slope = saturation / thermal * np.exp(found.state[-1] / thermal)
    assert R * C * found.eigenvalues[0].real == pytest.approx(1.0 / (2.0 + R * slope) - 1.0, rel=1e-11)


@pytest.mark.parametrize("seed", range(8))
def test_a_cycle_is_hidden_in_equations_of_any_index_and_units(seed: int) -> None:
    """P (diag(1, N) y)' = P (F, z - h(w)) with y = (w, z) = Q x, w of van der Pol's equation: a Hopf point at 0."""
    generator = np.random.default_rng(seed)
    nilpotent = block_diag(*(np.eye(size, k=1) for size in ([2, 1], [3])[seed % 2]))
    P, Q = (np.linalg.qr(each)[0] for each in generator.normal(size=(2, 5, 5)))
    units, rows = 10.0 ** generator.integers(-6, 7, size=(2, 5))
    time, parameter = 10.0 ** generator.integers(-6, 7, size=2).astype(float)
    x, p = ca.SX.sym("x", 5), ca.SX.sym("p")
    y = ca.DM(Q) @ (x / units)
    a, b, *z = y.elements()
    h = [generator.normal() * a + generator.normal() * b + 0.1 * generator.normal() * a * b for _ in z]
    f = ca.vertcat(
        b, p / parameter * b - (a**2 + 0.1 * a) * b - a, *(one - other for one, other in zip(z, h, strict=True))
    )
    mass = time * rows[:, None] * (P @ block_diag(np.eye(2), nilpotent) @ Q) / units
    model = OdeModel("hidden", x, ca.DM(rows[:, None] * P) @ f, p, mass=mass, nominal=[parameter])
    assert model.implicit is not None
    assert len(model.implicit.conditions) == 3
    start = find_equilibrium(model, 1e-3 * units, parameters={"p": -0.5 * parameter})
    (hopf,) = start.follow("p", parameter).special_points
    assert hopf.kind == "hopf"
    assert abs(hopf.parameters["p"]) <= min(1e-7 * parameter, hopf.error)
    assert time * hopf.frequency == pytest.approx(1.0, rel=1e-7)


@pytest.mark.parametrize("seed", [7, 23])
def test_period_at_rounding_has_its_error_though_the_profile_is_not_there(seed: int) -> None:
    """Van der Pol's equation hidden in one of index 3, with an error of the profile of 1e-8 or so."""
    generator, y = np.random.default_rng(seed), ca.SX.sym("y", 5)
    (a, b), z = y.elements()[:2], y.elements()[2:]
    h = [generator.normal() * (a, b, a)[k] + 0.1 * generator.normal() * a * b for k in range(3)]
    P, Q = (np.linalg.qr(each)[0] for each in generator.normal(size=(2, 5, 5)))
    f = ca.vertcat(b, (1.0 - a * a) * b - a, *(one - other for one, other in zip(z, h, strict=True)))
    x = ca.SX.sym("x", 5)
    nilpotent = np.eye(3, k=1)
    rhs = ca.DM(P) @ ca.substitute(f, y, ca.DM(Q) @ x)
    model = OdeModel("hidden", x, rhs, mass=P @ block_diag(np.eye(2), nilpotent) @ Q)
    plain = solve_ivp(lambda _, w: [w[1], (1.0 - w[0] ** 2) * w[1] - w[0]], (0.0, 50.0), [2.0, 0.0], dense_output=True,
                      rtol=1e-11, atol=1e-11)  # fmt: skip
    lifted, slope = [ca.vertcat(*h)], ca.vertcat(*f.elements()[:2])
    for _ in range(2):  # z = h + N z'
        lifted.append(ca.vertcat(*h) + nilpotent @ ca.jtimes(lifted[-1], ca.vertcat(a, b), slope))
    lift = ca.Function("lift", [ca.vertcat(a, b)], [ca.vertcat(a, b, lifted[-1])])
    orbit = find_orbit(model, lambda t: Q.T @ np.array(lift(plain.sol(40.0 + t))).ravel(), CYCLE_PERIOD)
    assert orbit.error > 1e-9
    assert abs(orbit.period - 6.6632868593231301) <= orbit.period_error < 1e-10


def test_colpitts_oscillator_against_its_ode() -> None:
    nodes, plain = colpitts()
    R = np.sqrt(2.0) / 1.4
    found = []
    for model, guess in ((nodes, [5.0, 3.5, -4.0, -7.3, 1.5, -1.5]), (plain, [10.0, -7.3, 1.5])):
        (hopf,) = find_equilibrium(model, guess).follow("I", 3.0).special_points
        cycles = hopf.follow("I", 4.2, stability=True)
        found.append(
            [hopf.parameters["I"], *(p.parameters["I"] for p in cycles.special_points if p.kind == "period doubling")]
        )
    assert found[0][0] == pytest.approx(2.0 * R, rel=1e-12)
    assert len(found[0]) > 1
    assert found[0] == pytest.approx(found[1], rel=1e-8)


@pytest.mark.parametrize("angle", [0.02, 1.5, 3.0])
def test_pendulum_in_cartesian_coordinates(angle: float) -> None:
    guess, period = swing(angle)
    orbit = find_orbit(pendulum(0.5, -np.cos(angle)), guess, period)
    assert orbit.period == pytest.approx(period, rel=1e-8)
    states = orbit.evaluate(np.linspace(0.0, orbit.period, 50))
    assert np.max(np.abs(states[:, 0] ** 2 + states[:, 1] ** 2 - 1.0)) < 1e-7
    found = orbit.floquet()
    assert found.multipliers.size == 2
    x = orbit.evaluate(orbit.period * np.arange(400) / 400)
    closed = np.exp(-0.5 * orbit.period * np.mean(np.sum(x[:, 2:4] ** 2, axis=1)))
    assert found.others[0].real == pytest.approx(closed, abs=10 * found.other_errors[0] + 1e-9)


def test_pendulum_that_keeps_its_energy() -> None:
    guess, period = swing(1.0)
    model = pendulum(0.0)
    orbit = find_orbit(model, guess, period, select=model.state[1] + np.cos(1.0))
    assert orbit.period == pytest.approx(period, rel=1e-8)
    assert orbit.floquet().trivial == 2
    assert orbit.floquet().stable


def test_slider_crank_against_its_angle() -> None:
    q, omega, s, v, force = symbols("q omega s v force")
    r, rod, m, torque, friction = 0.5, 1.3, 2.0, 1.0, 0.4
    phi = (s - r * ca.cos(q)) ** 2 + (r * ca.sin(q)) ** 2 - rod**2
    rhs = [omega, torque - friction * omega + force * ca.gradient(phi, q), v, force * ca.gradient(phi, s) / m, phi]
    crank = OdeModel("crank", [q, omega, s, v, force], rhs, mass=np.diag([1.0, 1, 1, 1, 0]))
    place = r * ca.cos(q) + ca.sqrt(rod**2 - (r * ca.sin(q)) ** 2)
    slope, bend = ca.gradient(place, q), ca.gradient(ca.gradient(place, q), q)
    rate = (torque - friction * omega - m * slope * bend * omega**2) / (1.0 + m * slope**2)
    plain = OdeModel("angle", [q, omega], [omega, rate])
    period = 2.0 * np.pi * friction / torque
    one = find_orbit(crank, lambda t: [2.5 * t, 2.5, 1.5, 0.0, 0.0], period, rotations={"q": 1})
    other = find_orbit(plain, lambda t: [2.5 * t, 2.5], period, rotations={"q": 1})
    assert one.period == pytest.approx(other.period, rel=1e-9)
    assert one.floquet().others == pytest.approx(other.floquet().others, abs=1e-8)


def test_forced_circuits() -> None:
    """A source and a capacitor by a resistor, and at once: of index 2, with the rate of the source in its current."""
    source, v, i, t = symbols("source v i t")
    omega, R, C, A = 3.0, 0.7, 0.4, 2.0
    for resistor in (True, False):
        if resistor:
            rhs, mass = [i - (source - v) / R, (source - v) / R, source - A * ca.cos(omega * t)], np.diag([0.0, C, 0.0])
        else:  # beside it another one that relaxes
            rhs, mass = [i, (source - v) / R, source - A * ca.cos(omega * t)], np.diag([C, C, 0.0])
        model = OdeModel("forced", [source, v, i], rhs, mass=mass, time=t, forcing_period=2.0 * np.pi / omega)
        orbit = find_orbit(model, [0.0, 0.0, 0.0])
        response = A / (1.0 + 1j * omega * R * C)
        current = (A - response) / R if resistor else 1j * omega * C * A
        times = np.linspace(0.0, orbit.period, 17)
        waves = np.exp(1j * omega * times)
        expected = np.stack([(each * waves).real for each in (A, response, current)], axis=1)
        assert orbit.evaluate(times) == pytest.approx(expected, abs=1e-8)
        assert orbit.floquet().multipliers == pytest.approx([np.exp(-orbit.period / (R * C))], abs=1e-10)


def test_folds_of_a_tunnel_diode() -> None:
    v, j, bias = symbols("v j I")
    model = OdeModel("diode", [v, j], [bias - j, j - (v**3 / 3 - v)], bias, mass=np.diag([1.0, 0.0]), nominal=[-1.0])
    branch = find_equilibrium(model, [-2.0, -1.0]).follow("I", 1.0)
    folds = [point for point in branch.special_points if point.kind == "fold"]
    assert sorted(p.parameters["I"] for p in folds) == pytest.approx([-2.0 / 3.0, 2.0 / 3.0], abs=1e-9)
    assert [solution.eigenvalues.size for solution in branch.solutions] == [1] * len(branch.solutions)
    assert branch.solutions[0].eigenvalues.real < 0.0


@pytest.mark.parametrize("folds", [False, True])
def test_a_branch_where_equations_are_singular(folds: bool) -> None:
    """The eigenvalue 1/(2 p) of x' = y - p, x = y^2, or 1/p of p y' = y: nothing branches off at p = 0."""
    x, y, p = symbols("x y p")
    rhs = [y - p, x - y**2] if folds else [-x + y, y]
    model = OdeModel("singular", [x, y], rhs, p, mass=np.diag([1.0, 0.0]) if folds else [[1.0, 0.0], [0.0, p]])
    start = find_equilibrium(model, [1.0, 1.0] if folds else [0.0, 0.0], parameters={"p": 0.9})
    branch = start.follow("p", -1.0)
    assert not branch.special_points
    assert [not one.stable for one in (branch.solutions[0], branch.solutions[-1])] == [True, False]
    (gap,) = branch.unresolved
    assert "an eigenvalue goes through infinity" in gap.reason
    assert gap.end < 0.0 < gap.start
    assert gap.start - gap.end < 1e-6


def test_an_equilibrium_where_the_mass_is_singular_is_refused_by_its_name() -> None:
    x, y, p = symbols("x y p")
    model = OdeModel("singular", [x, y], [y - x, x - 2.0 * y], p, mass=[[1.0, 0.0], [0.0, p]])
    with pytest.raises(EquilibriumError, match=r"mass: no derivative of y follows with p = 0, where x = 0\.1"):
        find_equilibrium(model, [0.1, 0.05], parameters={"p": 0.0})


@pytest.mark.parametrize("time", [1e-9, 1.0, 1e9])
def test_boundary_values_of_a_pendulum_in_any_unit_of_time(time: float) -> None:
    """From an angle of 0.6 to another place in one unit of time; then its equation in the angle arrives there too."""
    model = pendulum(0.0)
    x, y, u, w, tension = model.state.elements()
    rhs = ca.vertcat(model.given_rhs[:4] / time, model.given_rhs[4])
    slow = OdeModel("slow", model.state, rhs, mass=model.mass)
    at = slow.start
    conditions = [
        at(x) - np.sin(0.6), slow.end(x) - 0.1, at(x) ** 2 + at(y) ** 2 - 1.0, at(x) * at(u) + at(y) * at(w),
        at(tension) - at(u) ** 2 - at(w) ** 2 + at(y),
    ]  # fmt: skip
    found = BoundaryValueProblem(slow, conditions, interval=(0.0, time)).solve([0.3, -0.9, 0.0, 0.0, 1.0])
    first, last = found.evaluate(np.array([0.0, time]))
    start = [0.6, first[2] / np.cos(0.6)]
    swung = solve_ivp(lambda _, q: [q[1], -np.sin(q[0])], (0.0, 1.0), start, rtol=1e-11, atol=1e-12).y[:, -1]
    assert last[:4] == pytest.approx(
        [np.sin(swung[0]), -np.cos(swung[0]), swung[1] * np.cos(swung[0]), swung[1] * np.sin(swung[0])], abs=1e-9
    )


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1.0, 1e9])
def test_simulations_in_any_unit_of_time(unit: float) -> None:
    """A pendulum returns after its period, and van der Pol's equation, an ODE, moves as in units of 1."""
    model, (at, period) = pendulum(0.0), swing(1.5)
    slow = OdeModel("slow", model.state, ca.vertcat(model.given_rhs[:4] / unit, model.given_rhs[4]), mass=model.mass)
    times = unit * period * np.array([0.0, 0.25, 0.5, 1.0])
    for states in (simulate(slow, at(0.0), times).states, evolve(slow, at(0.0), None, times).states):
        assert states[:, 0] == pytest.approx(np.sin(1.5) * np.array([1.0, 0.0, -1.0, 1.0]), abs=1e-7)
    plain = plain_circuit()
    fast = OdeModel("fast", plain.state, plain.rhs / unit, plain.parameters, nominal=[1.0])
    times = np.linspace(0.0, 6.0, 4)
    expected = simulate(plain, [1.0, 0.0], times).states
    assert simulate(fast, [1.0, 0.0], unit * times).states == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
def test_transistor_amplifier(tolerance: float) -> None:
    """Of the Test Set for IVP Solvers (Mazzia and Magherini 2008), whose reference is at the time 0.2: of index 1."""
    t, y = ca.SX.sym("t"), [ca.SX.sym(f"y{k + 1}") for k in range(8)]
    R, supply, alpha = 9000.0, 6.0, 0.99
    first, second = (1e-6 * (ca.exp((y[k] - y[k + 1]) / 0.026) - 1.0) for k in (1, 4))
    rhs = [
        (y[0] - 0.1 * ca.sin(200.0 * np.pi * t)) / 1000.0, (2.0 * y[1] - supply) / R + (1.0 - alpha) * first,
        y[2] / R - first, (y[3] - supply) / R + alpha * first, (2.0 * y[4] - supply) / R + (1.0 - alpha) * second,
        y[5] / R - second, (y[6] - supply) / R + alpha * second, y[7] / R,
    ]  # fmt: skip
    pair = np.array([[-1.0, 1.0], [1.0, -1.0]])
    mass = 1e-6 * block_diag(1.0 * pair, -2.0, 3.0 * pair, -4.0, 5.0 * pair)
    model = OdeModel("amplifier", y, rhs, time=t, forcing_period=0.01, mass=mass)
    found = simulate(model, [0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0], [0.0, 0.1, 0.2], tolerance=tolerance)
    expected = [
        -0.5562145012262709e-2, 3.006522471903042, 2.849958788608128, 2.926422536206241, 2.704617865010554,
        2.761837778393145, 4.770927631616772, 1.236995868091548,
    ]  # fmt: skip
    assert np.max(np.abs(found.states[-1] - expected)) <= 6.0 * tolerance  # of its largest component
    pairs = mass @ np.array(model.vector_field(0.2, found.states[-1], [])).ravel()
    assert pairs == pytest.approx(np.array(model.function("f", model.given_rhs)(0.2, expected, [])).ravel(), abs=1e-7)
    assert found.evaluations < 50_000


def test_impasse_is_refused_soon_with_the_states_before_it() -> None:
    """x' = -1 with y = s/2 + 3 and x = (s/2)^2: none beyond x = 0."""
    x, y = symbols("x y")
    model = OdeModel("impasse", [x, y], [-1.0, x - y - (y - 3.0) ** 2], mass=[[1.0, -1.0], [0.0, 0.0]])
    begun = process_time()
    with pytest.raises(EvolutionError, match="IDA_CONV_FAIL") as caught:
        evolve(model, [8.0, 5.0], None, np.linspace(0.0, 4.0, 9))
    assert process_time() - begun < 3.0
    x, y = caught.value.evolution.states.T
    assert y - 3.0 == pytest.approx(np.sqrt(x - y), abs=1e-9)


def test_simulation_starts_consistent_and_follows_the_equations_kept() -> None:
    times, model = np.linspace(0.0, 6.0, 61), pendulum(0.5, -np.cos(1.5))
    found = simulate(model, {"x": 0.9, "y": -0.1}, times, tolerance=1e-10)
    x, y, u, w, _ = found.states.T
    assert np.max(np.abs(x**2 + y**2 - 1.0)) < 1e-8
    assert np.max(np.abs(x * u + y * w)) < 1e-8
    other = evolve(model, found.states[0], None, times, method="dop853", tolerance=1e-11)
    assert found.states == pytest.approx(other.states, abs=1e-7)
    plain = simulate(plain_circuit(), [1.0, 0.0], times).states
    assert simulate(circuit(), [1.0, 0.0, 9.0], times).states[:, :2] == pytest.approx(plain, abs=1e-7)


@pytest.mark.parametrize("share", [1e-2, 1e2])
def test_pendulum_whatever_the_rate(share: float) -> None:
    (guess, period), model = swing(1.5), pendulum(0.5, -np.cos(1.5))
    fields = {"rhs": model.given_rhs, "mass": model.mass, "decay": share * 2.0 * np.pi / period}
    orbit = find_orbit(OdeModel("pendulum", model.state, **fields), guess, period)
    own = find_orbit(model, guess, period)
    assert orbit.period == pytest.approx(period, rel=1e-9)
    assert orbit.floquet().others == pytest.approx(own.floquet().others, abs=1e-9)


@pytest.mark.parametrize(("y", "eigenvalues"), [(-0.9, [1j, -1j]), (0.9, [1.0, -1.0])])
def test_pendulum_at_rest(y: float, eigenvalues: list[complex]) -> None:
    found = find_equilibrium(pendulum(0.0), [0.1, y, 0.0, 0.0, 0.0])
    assert found.state == pytest.approx([0.0, np.sign(y), 0.0, 0.0, -np.sign(y)], abs=1e-10)
    assert found.eigenvalues == pytest.approx(eigenvalues, abs=1e-10)


def test_growth_of_changes_that_meet_the_equations() -> None:
    """x' = -3 x + p z with z = x/2: -3 + p/2, whose slope by p is 1/2, below the rate of any algebraic equation."""
    x, z, p = symbols("x z p")
    rhs = [-3.0 * x + p * z + 1.0, z - x / 2]
    model = OdeModel("decaying", [x, z], rhs, p, mass=np.diag([1.0, 0.0]), nominal=[0.5], decay=0.1)
    start = find_equilibrium(model, {"x": 0.1, "z": 40.0}, transient=10.0)  # which a simulation makes consistent
    assert start.state == pytest.approx([1.0 / 2.75, 0.5 / 2.75])
    assert start.eigenvalues == pytest.approx([-2.75])
    found = start.gradient("max_growth")
    assert found.value == pytest.approx(-2.75)
    assert found["p"] == pytest.approx(0.5)


@pytest.mark.slow
def test_cycles_end_at_a_homoclinic_orbit_at_any_rate() -> None:
    """Sandstede's planar system, as `test_period_limits` has it, with x^2 as a state: at mu = 0."""
    x, y, z, mu = symbols("x y z mu")
    a, square = 0.3, z
    rhs = [
        a * x + y - a * square + mu * x * (2 - 3 * x),
        x + a * y - 1.5 * square - 1.5 * a * x * y - 2 * mu * y,
        z - x**2,
    ]
    for decay in (0.02, None):
        model = OdeModel("leaf", [x, y, z], rhs, mu, mass=np.diag([1.0, 1.0, 0.0]), decay=decay)
        (hopf,) = find_equilibrium(model, [0.67, 0.0, 0.45], parameters={"mu": -0.5}).follow("mu", 0.5).special_points
        end = hopf.follow("mu", 0.5).special_points[-1]
        assert end.kind == "homoclinic"
        assert abs(end.parameters["mu"]) <= end.error


def test_saved_and_pickled(tmp_path: Path) -> None:
    model, point = circuit(decay=2.0), [0.3, -0.2, 0.1]
    for again in (read_model(save_model(model, tmp_path / "model.json")), pickle.loads(pickle.dumps(model))):
        assert again.decay == 2.0
        assert again.implicit is not None
        assert again.implicit.conditions
        assert np.array(again.vector_field(0.0, point, [1.0])) == pytest.approx(
            np.array(model.vector_field(0.0, point, [1.0])), rel=1e-15
        )


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"mass": np.eye(2)}, r"mass: given shape \(2, 2\); accepted: 3 x 3 finite numbers"),
        ({"mass": np.zeros((3, 3))}, "mass: given one without entries; accepted: one of rank 1 or more"),
        ({"mass": np.diag([1.0, np.nan, 0.0])}, "mass: given nan in row 2, column 2; accepted"),
        ({"mass": "diagonal"}, "mass: given str that is no matrix; accepted"),
        ({"mass": [[1, 2], [3]]}, "mass: given list that is no matrix; accepted"),
        ({"mass": np.diag([1.0, 1.0, 0.0]), "decay": 0.0}, "decay: given 0.0; accepted: a number > 0"),
        ({"decay": 1.0}, "decay: given without mass; accepted"),
        ({"mass": np.diag([1.0, 1.0, 0.0]), "reversal": [1, -1, 1]}, "reversal: given with a singular mass"),
    ],
)
def test_refusals(fields: dict[str, Any], words: str) -> None:
    v, i, z = symbols("v i z")
    with pytest.raises((TypeError, ValueError), match=f"refused: {words}") as told:
        OdeModel("refused", [v, i, z], [-i - z, v, z - v**3], **fields)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("last", ["0", "v"])
def test_equations_that_determine_no_motion_are_refused_by_name(last: str) -> None:
    v, i, z = symbols("v i z")
    with pytest.raises(
        ValueError, match=r"refused: mass: given one with which entry \d of rhs, beside \w, .*; accepted"
    ):
        OdeModel("refused", [v, i, z], [-i, v, {"0": 0.0 * z, "v": v}[last]], mass=np.diag([1.0, 1.0, 0.0]))


def test_models_without_such_a_form_are_refused() -> None:
    x, q, v = ca.MX.sym("x", 2), ca.SX.sym("q"), ca.SX.sym("v")
    with pytest.raises(ValueError, match="mass: given with a model in MX; accepted: one of first order in SX"):
        OdeModel("refused", x, -x, mass=np.eye(2))
    with pytest.raises(
        ValueError, match="mass: given with a model of second order; accepted: one of first order in SX"
    ):
        OdeModel("refused", q, -q, order=2, velocity=v, mass=[[1.0]])
    v, i = symbols("v i")
    with pytest.raises(ValueError, match="mass: given v in row 1, column 1; accepted"):
        OdeModel("refused", [v, i], [-i, v], mass=ca.diag(ca.vertcat(v, 1.0)))


@pytest.mark.skipif(not COMPILERS, reason="there is no C compiler")
def test_exported_rates_are_those_of_the_model(tmp_path: Path) -> None:
    model = circuit(decay=2.0)
    library = Library(export_c(model, tmp_path / "circuit"), "circuit")
    x, p, rates = np.array([0.3, -0.2, 0.1]), np.array([1.0]), np.zeros(3)
    library.call("rhs", 0.0, x, p, rates, library.work("RHS_WORK"))
    z = 0.3**3 / 3 - 0.3  # v' = -i - z, i' = v, and z - (v^3/3 - mu v) decays at the rate 2
    assert rates == pytest.approx([0.2 - 0.1, 0.3, (0.3**2 - 1.0) * 0.1 - 2.0 * (0.1 - z)], rel=1e-13)


@pytest.mark.slow
def test_scene_of_a_circuit(tmp_path: Path, cli: Cli) -> None:
    run = Runs(tmp_path, cli)
    save_model(colpitts()[0], tmp_path / "colpitts.json")
    start = {"vcc": 5.0, "vn": 3.5, "vc": -4.0, "ve": -7.3, "il": 1.5, "iv": -1.5}
    scene = table("model", file="colpitts.json") + table("equilibrium", start=start)
    run(scene + table("continuation", parameter="I", to=4.5, switch=["hopf"]) + table("stability"))
    found = column(run.out / "special_points.csv", "I")
    assert found == pytest.approx([2.0 * np.sqrt(2.0) / 1.4, 4.1103451502505], rel=1e-11)
