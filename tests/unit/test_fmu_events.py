"""FMUs with event indicators: solutions along which none changes its sign are a smooth model's, others are refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import changed, recompiled
from kernels import numpy_alone

from casadi_skin import OdeModel, export_fmu, find_equilibrium, find_orbit, import_fmu, simulate
from casadi_skin.fmu.description import FmuWarning
from casadi_skin.fmu.model import FmuModel
from casadi_skin.model.integrators import dop853
from casadi_skin.model.jumps import JumpError

LIMIT = 3.5  # of the velocity: that of van der Pol's cycle comes to 2.67 at mu = 1, and to 4.1 at mu = 2.5
ACCEPTED = "accepted: solutions along which no event indicator changes the sign that it has at the FMU's start"
INDICATORS = """
fmi{0}Status fmi{0}GetEventIndicators({1} c, {2} z[], size_t count) {{
    {2} x[2];
    z[0] = 1.0;
    if (count != 2 || fmi{0}GetContinuousStates(c, x, 2) > 1) return 3;
    z[1] = 3.5 - x[1];
    return 0;
}}
"""


def van_der_pol() -> OdeModel:
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    rhs = ca.vertcat(x[1], mu * (1 - x[0] ** 2) * x[1] - x[0])
    return OdeModel("vdp", x, rhs, mu, nominal=(1.0,), state_labels=("x", "v"), parameter_labels=("mu",))


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> FmuModel:
    """Van der Pol's oscillator with two event indicators: 1, and LIMIT - v."""
    folder, fmi = tmp_path_factory.mktemp("events"), request.param
    two = fmi == "2.0"
    names = ("2", "fmi2Component", "fmi2Real") if two else ("3", "fmi3Instance", "fmi3Float64")
    old = f"NO_VARIABLES(GetEventIndicators, ({names[1]} c, {names[2]} indicators[], size_t count))"
    smooth = export_fmu(van_der_pol(), folder / "smooth.fmu", fmi, start=[2.0, 0.0])
    path = recompiled(smooth, folder / "binary.fmu", fmi, old, INDICATORS.format(*names), f"fmi{names[0]}.c")

    def told(text: bytes) -> bytes:
        text = text.replace(b'numberOfEventIndicators="0"', b'numberOfEventIndicators="2"')
        named = b'<EventIndicator valueReference="1" /><EventIndicator valueReference="2" /></ModelStructure>'
        return text if two else text.replace(b"</ModelStructure>", named)

    path = changed(path, folder / "events.fmu", {"modelDescription.xml": told})
    with pytest.warns(FmuWarning, match=r"events.fmu: event indicators, 2 of them: it is followed between events, and"):
        return import_fmu(path, parameters=["mu"])


def crossed(model: FmuModel) -> str:
    return f"event indicator {model.instance.variables.indicators[1]} changes its sign at t = "


def time_of(words: str) -> float:
    return float(words.split("t = ")[1].split(";")[0])


def circle(t: float) -> list[float]:
    return [2.0 * np.cos(t), -2.0 * np.sin(t)]


def test_an_orbit_between_events_is_that_of_the_smooth_model(model: FmuModel) -> None:
    found, known = (find_orbit(one, circle, 6.66, parameters={"mu": 1.0}) for one in (model, van_der_pol()))
    assert found.period == pytest.approx(known.period, rel=1e-9)
    assert find_equilibrium(model, [0.1, 0.0]).state == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_branch_ends_where_an_indicator_changes_its_sign(model: FmuModel) -> None:
    branch = find_orbit(model, circle, 6.66, parameters={"mu": 1.0}).follow("mu", 3.0)
    assert crossed(model) in branch.reason
    t = np.linspace(0.0, 12.0, 6001)
    peaks = [np.max(simulate(van_der_pol(), [2.0, 0.0], t, parameters={"mu": mu}).states[:, 1]) for mu in branch["mu"]]
    assert len(peaks) > 2
    assert peaks[0] < LIMIT < 4.0
    assert np.all(np.array(peaks) < LIMIT)


def test_an_orbit_across_an_event_is_refused(model: FmuModel) -> None:
    known = find_orbit(van_der_pol(), circle, 6.66, parameters={"mu": 1.0}).follow("mu", 2.5, at=[2.5]).at(2.5)
    with pytest.raises(JumpError, match=f"^vdp: {crossed(model)}.*, along .*; {ACCEPTED}$"):
        find_orbit(model, known, known.period, parameters={"mu": 2.5})


def test_a_motion_across_an_event_is_refused(model: FmuModel) -> None:
    """Also between two times of output, at the time of the smooth model."""
    t = np.linspace(0.0, 12.0, 24001)
    smooth = simulate(van_der_pol(), [2.0, 0.0], t, parameters={"mu": 3.0}).states
    first = int(np.argmax(smooth[:, 1] > LIMIT))
    time = np.interp(LIMIT, smooth[first - 1 : first + 1, 1], t[first - 1 : first + 1])
    before = first - 100
    assert before > 0
    for follow in (
        lambda end: simulate(model, [2.0, 0.0], [0.0, end], parameters={"mu": 3.0}).states,
        lambda end: dop853(model, np.array([3.0]), np.array([2.0, 0.0]), np.array([end]), 1e-9).states,
    ):
        np.testing.assert_allclose(follow(t[before])[-1], smooth[before], atol=1e-6)
        with pytest.raises(JumpError, match=f"^vdp: {crossed(model)}.*; {ACCEPTED}$") as said:
            follow(12.0)
        assert time_of(str(said.value)) == pytest.approx(time, abs=1e-5)


def test_what_is_beyond_an_event_between_places_is_seen(model: FmuModel) -> None:
    """The velocity comes to a peak beyond the limit between two places, with that at both below; or stays below."""
    start, fine = [2.0, 0.0], np.linspace(0.0, 12.0, 12001)
    for mu, beyond in ((1.755, True), (1.72, False)):
        states = simulate(van_der_pol(), start, fine, parameters={"mu": mu}).states
        peak = int(np.argmax(states[:, 1]))
        assert (states[peak, 1] > LIMIT) == beyond
        coarse = np.arange((peak - 50) % 100, fine.size, 100)
        assert np.all(states[coarse, 1] < LIMIT)
        words = model.jumps.along(fine[coarse], states[coarse], np.array([mu]))
        assert words.startswith(crossed(model)) == beyond
        if beyond:
            known = fine[np.argmax(states[:, 1] > LIMIT)]
            assert time_of(words) == pytest.approx(known, abs=0.01)
        with numpy_alone():
            assert model.jumps.along(fine[coarse], states[coarse], np.array([mu])) == words


def test_an_indicator_that_is_zero_at_the_last_place_is_named(model: FmuModel) -> None:
    """Interpolation puts it to either side of zero."""
    t, generator = np.linspace(0.0, 1.0, 7), np.random.default_rng(0)
    for _ in range(50):
        velocity = LIMIT - generator.uniform(0.5, 2.0) * (1.0 - t) * (1.0 + generator.uniform() * t)
        states = np.column_stack([generator.normal(size=7), velocity])
        words = model.jumps.along(t, states, np.array([1.0]))
        assert words.startswith(crossed(model))
        assert time_of(words) == pytest.approx(1.0, abs=1e-6)


def test_equilibria_end_where_a_parameter_changes_the_sign_at_the_start(model: FmuModel) -> None:
    """The FMU would be started with the equations of the other side: here its start is said to be there."""
    states, parameters = np.array([[2.0, 0.0], [2.0, 0.0]]), np.array([[1.0], [1.5]])
    at = model.jumps._at

    def by_parameter(times: np.ndarray, states: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, positive = at(times, states, rows)
        side = 1.2 - rows[:, 0]
        return np.column_stack([values[:, 0], side]), np.column_stack([positive[:, 0], side > 0.0])

    assert not model.jumps.along(np.zeros(2), states, parameters)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(model.jumps), "_at", by_parameter)
        assert model.jumps.along(np.zeros(2), states, parameters).startswith(crossed(model))
        branch = find_equilibrium(model, [0.1, 0.0], parameters={"mu": 1.0}).follow("mu", 1.5)
    assert crossed(model) in branch.reason
    assert branch["mu"][-1] < 1.2


def test_a_start_beyond_an_event_is_refused(model: FmuModel) -> None:
    with pytest.raises(JumpError, match=crossed(model)):
        simulate(model, [0.0, 4.0], [0.0, 0.001])
