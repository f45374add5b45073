"""FMUs for Co-Simulation as maps: orbits, periods and multipliers within their errors of closed forms and of Model
Exchange, in any units; what cannot be done is refused in one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import changed, slave

from casadi_skin import (
    BoundaryError,
    Chain,
    OdeModel,
    export_fmu,
    find_orbit,
    import_co_simulation,
    import_fmu,
    read_result,
)
from casadi_skin.export.codegen import build_library
from casadi_skin.fmu import co_simulation
from casadi_skin.fmu.description import library_name
from casadi_skin.fmu.map_orbit import EPSILON, fixed_point, measured_noise


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Binaries of ours are tried in a process of their own, of 2 s, in one test alone."""
    if "trial" not in request.node.name:
        monkeypatch.setattr(co_simulation, "check_answer", lambda *_: None)


def refusal(call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    with pytest.raises((ValueError, TypeError, BoundaryError)) as error:
        call(*arguments, **options)
    assert "\n" not in str(error.value)
    return str(error.value)


# Orbits in closed form ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_cycles_of_a_noisy_slave_in_any_units(seed: int, tmp_path: Path) -> None:
    """|z| = sqrt(mu/cubic), with the multiplier exp(-4 pi mu/omega): above 1 where both are negative."""
    rng = np.random.default_rng(seed)
    omega, sign, noise = rng.uniform(0.5, 3.0), 1.0 if seed % 2 else -1.0, 10.0 ** rng.uniform(-8, -5)
    mu, cubic = sign * omega * rng.uniform(0.03, 0.12), sign * rng.uniform(0.3, 3.0)
    units, radius = 10.0 ** rng.uniform(-6, 6, 2), math.sqrt(mu / cubic)
    path = slave(
        tmp_path, mu=mu, cubic=cubic, omega=omega, noise=noise, size_x=units[0], size_y=units[1], x=radius * units[0],
        substeps=4,
    )  # fmt: skip
    model = import_co_simulation(path, step=0.05 / omega)
    orbit = model.find_orbit([1.05 * radius * units[0], 0.0])
    z, error = orbit.state / units, orbit.state_error / units
    assert abs(math.hypot(*z) - radius) <= np.abs(z) @ error / radius <= 1e4 * noise * radius
    assert abs(orbit.period - 2 * np.pi / omega) <= orbit.period_error <= 1e4 * noise / omega
    (multiplier,), (wrong,) = orbit.multipliers, orbit.multiplier_errors
    assert abs(multiplier - math.exp(-4 * np.pi * mu / omega)) <= wrong <= 0.05
    assert orbit.stable is (sign > 0.0)
    assert orbit.noise >= 0.1 * noise
    assert np.ptp(np.hypot(*(orbit.states / units).T)) <= (1e2 * noise + 1e-5) * radius  # a circle
    assert (orbit.t[0], orbit.t[-1]) == (0.0, orbit.period)


@pytest.mark.parametrize(
    ("driven", "cycles"), [(False, 1), (True, 1), pytest.param(True, 2, marks=pytest.mark.slow), (False, 3)]
)
def test_forced_orbits_by_what_is_inside_and_by_inputs(driven: bool, cycles: int, tmp_path: Path) -> None:
    """z' = lambda z + A cos(drive t), stable and unstable; an input is constant within a step, which the error has."""
    drive = 1.7
    for mu in (-0.1, 0.07):
        rate, noise, size = mu + 1.0j, 1e-8, 1e3
        period = 2 * np.pi / drive
        force = {} if driven else {"force": 0.8, "drive": drive}
        path = slave(tmp_path, mu=mu, cubic=0.0, noise=noise, size_y=size, **force)
        inputs = {"u": lambda t: 0.8 * ca.cos(drive * t)} if driven else None
        model = import_co_simulation(path, forcing_period=period, step=period / 100, inputs=inputs)
        orbit = model.find_orbit([0.0, 0.0], cycles=cycles)
        z = 0.4 / (1j * drive - rate) + 0.4 / (-1j * drive - rate)
        off = np.abs(orbit.state - [z.real, size * z.imag])
        assert np.all(off <= orbit.state_error)
        assert np.all(orbit.state_error <= np.array([1.0, size]) * (1e-2 if driven else 1e-4))
        assert (orbit.period, orbit.period_error) == (cycles * period, 0.0)
        exact = np.exp(np.array([rate, rate.conjugate()]) * cycles * period)
        offs = [np.min(np.abs(exact - multiplier)) for multiplier in orbit.multipliers]
        assert np.all(offs <= orbit.multiplier_errors)
        assert orbit.stable is (mu < 0.0)


def test_an_orbit_leads_to_that_at_the_next_parameter(tmp_path: Path) -> None:
    path = slave(tmp_path, mu=0.02, noise=1e-9)
    model, orbit = import_co_simulation(path, parameters=["mu", "cubic"]), None
    for mu in (0.02, 0.05, 0.1, 0.2):
        orbit = model.find_orbit([math.sqrt(mu), 0.0] if orbit is None else orbit, parameters={"mu": mu})
        assert orbit.parameters == {"mu": mu, "cubic": 1.0}
        assert abs(orbit.multipliers[0] - math.exp(-4 * np.pi * mu)) <= orbit.multiplier_errors[0]
    assert orbit is not None
    away = model.find_orbit([0.3, 0.3], parameters={"mu": 0.05}, transient=100.0, section=lambda x: x[0] + x[1])
    assert abs(away.state[0] + away.state[1]) <= 1e-12
    assert abs(math.hypot(*away.state) - math.sqrt(0.05)) <= math.hypot(*away.state_error)


def test_a_verdict_within_the_errors_is_none(tmp_path: Path) -> None:
    """The multiplier exp(-4 pi 1e-4), with noise 1e-4."""
    model = import_co_simulation(slave(tmp_path, mu=1e-4, cubic=1e-4, noise=1e-4))
    orbit = model.find_orbit([1.0, 0.0])
    assert orbit.stable is None
    assert orbit.undecided.tolist() == orbit.multipliers.tolist()
    assert "unresolved: " in str(orbit)
    assert "stability unresolved" in repr(orbit)


# The same model by Model Exchange -------------------------------------------------------------------------------------


def duffing() -> OdeModel:
    x, v, t, F = (ca.SX.sym(name) for name in ("x", "v", "t", "F"))
    rates = ca.vertcat(v, -0.2 * v + x - x**3 + F * ca.cos(t))
    return OdeModel(
        "duffing", ca.vertcat(x, v), rates, F, time=t, forcing_period=2 * np.pi, nominal=(0.2,), state_labels=("x", "v")
    )  # fmt: skip


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_orbits_of_our_own_fmus_as_by_collocation(fmi: Any, tmp_path: Path) -> None:
    """Duffing's oscillator: in a well, stable; round both, a saddle; on the hill between, where motions run away."""
    model = duffing()
    path = export_fmu(model, tmp_path / "duffing.fmu", fmi, start=[1.1, 0.0], tolerance=1e-6)
    simulated = import_co_simulation(path, forcing_period=2 * np.pi, parameters=["F"])
    assert simulated.state_names == ("x", "v")
    for guess, F, largest in (([-0.8, 0.0], 0.2, 0.54), ([-1.09, 0.65], 0.22, 5.6), ([-0.099, 0.01], 0.2, 281.0)):
        found = simulated.find_orbit(guess, parameters={"F": F})
        known = find_orbit(model, (found.t, found.states.T), parameters={"F": F})
        multipliers = known.floquet().multipliers
        assert np.max(np.abs(multipliers)) == pytest.approx(largest, rel=0.1)
        assert np.all(np.abs(found.state - known.evaluate(np.array([0.0])).ravel()) <= found.state_error)
        assert np.all(found.state_error <= 1e-4)
        for one, wrong in zip(found.multipliers, found.multiplier_errors, strict=True):
            assert np.min(np.abs(multipliers - one)) <= wrong <= 0.01 * largest
        assert found.stable is known.stable is (largest < 1.0)
        assert found.solver_seen


@pytest.mark.slow
def test_many_states_by_krylov_spaces(tmp_path: Path) -> None:
    """A driven chain of 24 damped sites, against collocation; a conservative one has no orbit that stands alone."""
    n, drive = 24, 1.3
    q, v, t, F = (ca.SX.sym(name, size) for name, size in (("q", n), ("v", n), ("t", 1), ("F", 1)))
    stretched = ca.vertcat(q[0], q[1:] - q[:-1], -q[-1])
    force = ca.vertcat(F * ca.cos(drive * t), ca.SX(n - 1, 1))
    rates = ca.vertcat(v, 0.8 * stretched[1:] - 1.2 * stretched[:-1] - 0.3 * q**3 - 0.15 * v + force)
    period = 2 * np.pi / drive
    model = OdeModel("chain", ca.vertcat(q, v), rates, F, time=t, forcing_period=period, nominal=(1.0,))
    path = export_fmu(model, tmp_path / "chain.fmu", start=np.zeros(2 * n), tolerance=1e-6)
    found = import_co_simulation(path, forcing_period=period, step=period / 40).find_orbit(transient=60.0)
    known = find_orbit(model, (found.t, found.states.T))
    assert np.all(np.abs(found.state - known.evaluate(np.array([0.0])).ravel()) <= found.state_error)
    assert np.all(found.state_error <= 1e-5)
    multipliers = known.floquet().multipliers
    assert 1 <= found.multipliers.size <= 8
    assert abs(found.multipliers[0]) == pytest.approx(np.max(np.abs(multipliers)), abs=1e-5)
    for one, wrong in zip(found.multipliers, found.multiplier_errors, strict=True):
        assert np.min(np.abs(multipliers - one)) <= wrong <= 1e-4
    free = import_co_simulation(export_fmu(Chain(3, 1.0, 0.25, 1.0), path, S=0.5), step=0.05).find_orbit()
    assert free.stable is None
    assert np.all(free.state_error == np.inf)
    assert "errors       not bounded: 1 may be a multiplier, as where something is conserved" in str(free)


def van_der_pol(folder: Path, **options: Any) -> Path:
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    rates = ca.vertcat(x[1], mu * (1 - x[0] ** 2) * x[1] - x[0])
    return export_fmu(OdeModel("vdp", x, rates, mu, nominal=(1.0,)), folder / "vdp.fmu", start=[2.0, 0.0], **options)


@pytest.mark.slow
def test_relaxation_and_results_as_others(tmp_path: Path) -> None:
    path = van_der_pol(tmp_path, tolerance=1e-9)
    model = import_co_simulation(path, parameters=["mu"], step=0.02)
    orbit = model.find_orbit(parameters={"mu": 2.0}, period=7.6)
    exchange = find_orbit(import_fmu(path, parameters=["mu"]), (orbit.t, orbit.states.T), 7.6, parameters={"mu": 2.0})
    assert abs(orbit.period - exchange.period) <= orbit.period_error <= 1e-5
    assert "period       7.62987" in str(orbit)
    assert "solver" not in str(orbit)
    assert list(orbit.to_dataframe()) == ["t", "x_0", "x_1"]
    assert len(orbit.plot().lines) == 2
    read = read_result(orbit.save(tmp_path / "orbit.skin"))
    assert read.states.tobytes() == orbit.states.tobytes()
    assert (
        model.find_orbit(read, parameters={"mu": 2.0}).period == model.find_orbit(orbit, parameters={"mu": 2.0}).period
    )
    assert simulated_again(model, orbit)


def simulated_again(model: Any, orbit: Any) -> bool:
    """Whether the orbit has the same bits when it is found again: nothing is left in the slave."""
    first, second = (model.find_orbit(orbit, parameters={"mu": 1.9}) for _ in range(2))
    return bool(np.array_equal(first.states, second.states))


# Slaves that are odd --------------------------------------------------------------------------------------------------


def test_slaves_that_take_states_late_and_do_not_reset(tmp_path: Path) -> None:
    plain = import_co_simulation(slave(tmp_path, mu=0.1)).find_orbit([0.3, 0.0])
    for odd in ("set late", "reset in part", "by parameters"):
        starts = {"x": "x0", "y": "y0"} if odd == "by parameters" else None
        found = import_co_simulation(slave(tmp_path, odd=odd, mu=0.1), starts=starts).find_orbit([0.3, 0.0])
        assert np.array_equal(found.states, plain.states)


def test_slaves_whose_own_steps_do_not_end_with_those_of_communication(tmp_path: Path) -> None:
    """Steps of 0.01 inside, whatever is asked: that of their error which no other step shows is not in the estimate."""
    path = slave(tmp_path, odd="lags", mu=0.1)
    orbit = import_co_simulation(path, step=0.02).find_orbit([0.3, 0.0])
    assert abs(orbit.period - 2 * np.pi) <= 1e-9
    assert not orbit.solver_seen
    assert "its error does not show: errors are those of the FMU's map alone" in str(orbit)
    decaying = slave(tmp_path, odd="lags", mu=-0.1, cubic=0.0, force=1.0, drive=2 * np.pi / 0.03)
    for step in (0.01, 0.03):  # three steps and one: neither half of them nor twice as many are had
        orbit = import_co_simulation(decaying, forcing_period=0.03, step=step).find_orbit([0.0, 0.0])
        assert abs(abs(orbit.multipliers[0]) - math.exp(-0.003)) <= orbit.multiplier_errors[0] <= 1e-5
        assert not orbit.solver_seen
    path = slave(tmp_path, odd="lags", mu=0.1)
    said = refusal(import_co_simulation, path, step=0.025)
    assert said.endswith("it is at t = 0.02 after a step to 0.025; accepted: steps that are multiples of its own")
    forced = import_co_simulation(slave(tmp_path, odd="lags", mu=-0.1, force=1.0), forcing_period=4.0, step=0.02)
    assert "starts anew" in refusal(forced.find_orbit, [0.0, 0.0])  # the force has the period 2 pi


def test_states_that_are_not_named_or_not_set_are_refused(tmp_path: Path) -> None:
    hidden = import_co_simulation(slave(tmp_path, odd="hidden", mu=0.1), states=["x", "y"])
    said = refusal(hidden.find_orbit, [0.3, 0.0])
    assert said.startswith("after a return it goes on elsewhere than it starts anew from there")
    assert "accepted: states= with all of them, and forcing_period= where it depends on time" in said
    alone = import_co_simulation(slave(tmp_path, mu=0.1), states=["x"])  # its section leaves no state to differ
    assert "one state without forcing has no orbit; accepted: states= with all of them" in refusal(alone.find_orbit)
    depends = import_co_simulation(slave(tmp_path, mu=0.1, force=0.05, drive=0.3))
    assert "starts anew" in refusal(depends.find_orbit, [0.3, 0.0])
    path = slave(tmp_path, odd="never set", mu=0.1)
    assert refusal(import_co_simulation, path).endswith(
        "it cannot be initialised: fmi2SetReal failed with status 3 (error)."
    )
    unnamed = slave(tmp_path, structure=False, mu=0.1)
    assert refusal(import_co_simulation, unnamed).endswith(
        "no states are named in its ModelStructure; accepted: states=[...]"
    )
    assert import_co_simulation(unnamed, states=["y", "x"]).find_orbit([0.0, 0.3]).stable


def test_arguments_that_do_not_fit_are_refused_in_a_line(tmp_path: Path) -> None:
    path = slave(tmp_path, mu=0.1)
    for words, options in (
        ("states: given 'z'; accepted: time, x, y, ", {"states": ["z"]}),
        ("starts: given 'z'; accepted: x, y", {"starts": {"z": "x0"}}),
        ("starts: given 'x1'; accepted: ", {"starts": {"x": "x1"}}),
        ("the state x is 1 after the initialisation, where 1.001 was put in; accepted: ", {"starts": {"x": "x0"}}),
        ("step: given 0; accepted: a number > 0", {"step": 0}),
        ("solver_tolerance: given -1.0; accepted: a number > 0", {"solver_tolerance": -1.0}),
        ("inputs, u: given a function of time; accepted: with forcing_period=", {"inputs": {"u": ca.cos}}),
        ("parameters: given 'm'; accepted: mu, ", {"parameters": ["m"]}),
    ):
        assert words in refusal(import_co_simulation, path, **options)
    model = import_co_simulation(path, parameters=["mu"])
    forced = import_co_simulation(path, forcing_period=3.0)
    for words, options in (
        ("guess: given 1 numbers; accepted: 2, one for each state", {"guess": [1.0]}),
        ("parameters: given 'nu'; accepted: mu", {"parameters": {"nu": 1.0}}),
        ("section: given 3; accepted: a function of the state", {"section": 3}),
        ("section(guess): given 'x'; accepted: a finite number", {"section": lambda x: "x"}),
        ("transient: given -1.0; accepted: a number >= 0", {"transient": -1.0}),
        ("cycles: given 0; accepted: a whole number >= 1", {"cycles": 0}),
        ("period: given -1.0; accepted: a number > 0", {"period": -1.0}),
    ):
        assert refusal(model.find_orbit, **options) == words
    assert refusal(forced.find_orbit, period=3.0) == "period: given 3.0; accepted: none, the forcing has the period"
    fails = import_co_simulation(slave(tmp_path, odd="fails", mu=0.1), step=0.5)
    assert "its step from t = 0 by 0.5 is not done: fmi2DoStep failed with status 2" in refusal(
        fails.find_orbit, [3.0, 0.0]
    )
    model.close()
    assert refusal(model.find_orbit).endswith("closed; accepted: calls before that")
    rest = import_co_simulation(slave(tmp_path, mu=-1.0))
    assert "the section is not crossed again up to t = 5000" in refusal(rest.find_orbit, [0.1, 0.0])
    exchange = van_der_pol(tmp_path)
    assert "no Model Exchange" in refusal(import_fmu, path)
    assert "is no multiple" not in refusal(import_co_simulation, exchange, step=-1.0)


def test_a_trial_of_the_binary_is_in_a_process_of_its_own(tmp_path: Path) -> None:
    path = slave(tmp_path, mu=0.1)
    broken = tmp_path / "broken.fmu"
    source = tmp_path / "slave_sources" / "slave_fmu.c"
    source.write_text(source.read_text().replace("if (c->mode != STEPPING) return ERROR;", "abort();"))
    library = build_library(source.parent, [source.name], tmp_path / "aborts")
    changed(path, broken, {library_name("2.0", "slave"): lambda _: library.read_bytes()})
    assert "its binary ends the process that calls it (SIGABRT)" in refusal(import_co_simulation, broken)
    assert import_co_simulation(path).find_orbit([0.3, 0.0]).stable


# Maps in closed form, without an FMU ----------------------------------------------------------------------------------


def noisy_cubic(
    matrix: Any, centre: Any, cubic: Any, noise: float, error: float, salt: float, y: Any
) -> Any:  # fmt: skip
    """A map with a fixed point at the centre but for the error, and noise that jumps."""
    d = y - centre
    rough = np.sin(np.arange(d.size + 1) * 78.2 + np.floor(1e6 * np.sum(d) * salt)) * 43758.5
    ends = np.append(centre + matrix @ d + cubic * d**3 + error, 1.0 + 0.1 * np.sum(d) + error)
    return ends + noise * (rough - np.floor(rough) - 0.5)


def twice(at: Any, y: Any) -> Any:
    """The map to the second return, and the time up to it."""
    first = at(y)
    second = at(first[:-1])
    return np.append(second[:-1], first[-1] + second[-1])


@pytest.mark.parametrize("n", [1, 3, 6, 60])
def test_errors_of_fixed_points_of_noisy_maps(n: int) -> None:
    """y = P(y) of a cubic map whose noise jumps, with an error that other ways show; many states by Krylov spaces."""
    ratios: list[float] = []
    for seed in range(2 if n == 60 else 12):
        rng = np.random.default_rng(seed)
        noise = 10.0 ** rng.uniform(-11, -6)
        vectors = np.eye(n) + 0.3 * rng.normal(size=(n, n)) / n
        values = rng.uniform(-1.4, 0.8, n) * np.where(np.arange(n) < 8, 1.0, 0.01)
        matrix, centre, cubic = (
            vectors @ np.diag(values) @ np.linalg.inv(vectors),
            rng.normal(size=n),
            rng.normal(size=n),
        )

        def way(error: float, salt: float, of: Any = (matrix, centre, cubic, noise)) -> Any:
            return partial(noisy_cubic, *of, error, salt)

        at = way(10 * noise, 1.0)
        ways = [way(noise, 1.3), way(5 * noise, 1.7)]
        start = centre + 0.01 * rng.normal(size=n) / n
        found = fixed_point(at, start, ways, partial(twice, at), False)
        ratios.append(np.max(np.abs(found.y - centre) / found.errors))
        ratios.append(abs(found.period - 1.0) / found.period_error)
        for value, error in zip(found.multipliers, found.multiplier_errors, strict=True):
            ratios.append(np.min(np.abs(values - value)) / error)
        leading = np.sort(np.abs(values))[::-1][:8]
        assert np.all(np.abs(np.abs(found.multipliers) - leading) <= found.multiplier_errors)
        assert np.max(found.errors) <= 1e4 * noise
    assert 0.01 < max(ratios) <= 1.0


@pytest.mark.parametrize("noise", [1e-12, 1e-9, 1e-6])
def test_noise_alone_is_in_the_errors(noise: float) -> None:
    """Where no other way shows anything: as large as 30 places are off, and ten times the noise along 0.95."""
    off = []
    for seed in range(30):
        centre = np.random.default_rng(seed).normal(size=2)
        at = partial(noisy_cubic, np.diag([0.95, -0.3]), centre, np.ones(2), noise, 0.0, 1.0 + seed)
        found = fixed_point(at, centre + 0.01, [], partial(twice, at), False)
        off.append(np.max(np.abs(found.y - centre) / found.errors))
        assert np.all(found.errors >= [10 * noise, noise])
        assert np.all(found.errors <= 1e3 * noise)
    assert max(off) <= 1.0


def test_the_error_of_an_orbit_is_in_its_multipliers() -> None:
    """The orbit 0 is off by 1e-6, which changes the multiplier 0.99 by 6e-6."""

    def way(error: float, y: Any) -> Any:
        return np.append(0.99 * y + 3.0 * y**2 + error, 1.0)

    at = partial(way, 1e-8)
    found = fixed_point(at, np.array([1e-4]), [partial(way, 0.0)], partial(twice, at), False)
    assert 5e-6 <= abs(found.multipliers[0] - 0.99) <= found.multiplier_errors[0] <= 1e-4


def test_noise_is_measured_and_smooth_maps_have_little() -> None:
    rng = np.random.default_rng(0)
    y = np.array([0.3, -0.2])
    smooth = measured_noise(lambda y: np.append(np.sin(y), 1.0), y)
    assert EPSILON <= smooth <= 1e-14
    for size in (1e-10, 1e-5):
        found = measured_noise(lambda y, size=size: np.append(np.sin(y), 1.0) + size * rng.normal(size=3), y)
        assert 0.4 * size <= found <= 3.0 * size


def test_maps_without_a_fixed_point_are_refused() -> None:
    def shift(y: Any) -> Any:
        return np.append(y + 0.1 + y**2, 1.0)

    with pytest.raises(
        BoundaryError, match=r"no orbit is found: the nearest motion comes back to 1\.0e-01 of the ranges"
    ):
        fixed_point(shift, np.array([0.5]), [], partial(twice, shift), False)


def test_a_second_return_that_takes_another_time_is_no_map() -> None:
    """As where a section holds the one state that is named, and the others go on."""

    def still(y: Any) -> Any:
        return np.append(0.5 * y, 1.0)

    def later(y: Any) -> Any:
        return np.append(0.25 * y, 2.1)

    with pytest.raises(BoundaryError, match="after a return it goes on elsewhere than it starts anew from there"):
        fixed_point(still, np.array([0.1]), [], later, True)
