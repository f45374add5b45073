"""Whatever every public name is called with, it does its work or raises a documented exception with one line."""

from __future__ import annotations

import functools
import random
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import casadi as ca
import numpy as np
import pytest

import casadi_skin
from casadi_skin import (
    Bond,
    BoundaryValueProblem,
    Branch,
    Chain,
    Evolution,
    Lattice,
    LongLattice,
    OdeModel,
    Orbit,
    Site,
    SymmetryClass,
    Uniform,
    bands,
    brillouin_zone,
    build_c,
    conservative_part,
    distance_from_orbit,
    energy_balance,
    evolve,
    export_c,
    export_fmu,
    find_equilibria,
    find_equilibrium,
    find_orbit,
    fit_parameters,
    follow_family,
    harmonic_shares,
    import_co_simulation,
    import_fmu,
    initial_state,
    lattice_modes,
    optimise,
    pareto_front,
    perturbed,
    read_map,
    read_model,
    read_result,
    resonances,
    run_map,
    save_model,
    save_result,
    search_orbit,
    simulate,
    simulate_orbit,
    smallest_kick,
    spreading,
    third_harmonic_leads,
    winding_numbers,
)
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.result import Result
from casadi_skin.search.kick import KickError
from casadi_skin.stability.flows import FlowError

LONGEST = 20  # seconds that a call may take; what takes longer has started work, and is stopped
DOCUMENTED = (ValueError, TypeError, BoundaryError, FlowError, KickError, ArithmeticError, OSError)

T, X, Y, MU, Q, V, C = (ca.SX.sym(name) for name in ("t", "x", "y", "mu", "q", "v", "c"))
VAN_DER_POL = OdeModel("van der Pol", ca.vertcat(X, Y), ca.vertcat(Y, MU * (1 - X**2) * Y - X), MU, nominal=(0.1,))
FORCED = OdeModel("forced", ca.vertcat(X, Y), ca.vertcat(Y, -X - Y + ca.cos(T)), time=T, forcing_period=2 * np.pi)
SPRING = OdeModel(
    "spring", Q, -Q - C * Q**3, C, 2, V, reversal=(1, -1), half_period=(-1, -1), nominal=(1.0,),
    hamiltonian=V**2 + Q**2 + C * Q**4 / 2,
)  # fmt: skip
LINE = OdeModel("line", ca.vertcat(X, Y), ca.vertcat(Y, -MU * X), MU, nominal=(1.0,))
PROBLEM: dict[str, Any] = {
    "model": LINE, "conditions": [LINE.start(X), LINE.end(X) - 1], "integrals": (), "interval": (0.0, 1.0),
    "parameters": {"mu": 1.0}, "free": (), "bounds": {}, "objective": None, "running": None,
}  # fmt: skip
SITE, BOND = Site("a", "k*s*y + y^3"), Bond("a", "a", (1, 0))
CHAIN = Chain(2, 1.0, 0.25, 1.0)
DRIVEN = Lattice(
    2, [Site("a", "y", damping="c", drive="cos(w*t)")], [Bond("a", "a", (1,))], parameters={"c": 0.1, "w": 1.0}
)


def circle(t: float) -> list[float]:
    return [2 * np.cos(t), -2 * np.sin(t)]


@functools.cache
def orbit() -> Orbit:
    found = find_orbit(FORCED, [0.0, 0.0], tolerance=1e-4)
    assert isinstance(found, Orbit)
    return found


@functools.cache
def branch() -> Branch:
    return follow_family(CHAIN, 1, 0.05, tolerance=1e-4, at=[0.03])


@functools.cache
def evolution() -> Evolution:
    return evolve(CHAIN, [0.1, 0.0], None, [0.0, 0.5, 1.0], tolerance=1e-6)


@functools.cache
def solution() -> Any:
    return BoundaryValueProblem(**PROBLEM).solve([0.0, 1.0], tolerance=1e-4)


# Each public name with arguments that are right and soon done; of classes also the methods.
CALLS: dict[str, tuple[Callable[[], Callable[..., Any]], dict[str, Any]]] = {
    "Chain": (lambda: Chain, {"sites": 2, "alpha": 1.0, "gamma": 0.25, "g": 1.0}),
    "Lattice": (
        lambda: Lattice,
        {"cells": (2, 2), "sites": [SITE], "bonds": [BOND], "boundary": "free", "parameters": {"k": 1.0, "s": "n"},
         "name": "lattice", "forcing_period": None},
    ),
    "LongLattice": (
        lambda: LongLattice,
        {"cells": 40, "sites": [SITE], "bonds": [Bond("a", "a", (1,))], "boundary": "free",
         "parameters": {"k": 1.0, "s": 2.0}, "edge": "last", "name": "lattice"},
    ),
    "Site": (
        lambda: Site,
        {"name": "a", "onsite": "y", "mass": "1", "damping": "0", "drive": "0"},
    ),
    "Bond": (lambda: Bond, {"start": "a", "end": "a", "offset": (1,), "force": "d", "gain": ("1", "1")}),
    "Uniform": (lambda: Uniform, {"low": 0.0, "high": 1.0, "seed": 1}),
    "OdeModel": (
        lambda: OdeModel,
        {
            "name": "spring", "state": Q, "rhs": -Q - C * Q**3, "parameters": C, "order": 2, "velocity": V,
            "reversal": (1, -1), "half_period": (-1, -1), "normalisation": Q**2 - 1, "hamiltonian": None,
            "output_scale": (1.0,), "time": None, "forcing_period": None, "outputs": {"force": Q**3}, "nominal": (1.0,),
            "state_labels": ("q", "v"), "parameter_labels": ("c",), "checked": True,
        },
    ),
    "BoundaryValueProblem": (lambda: BoundaryValueProblem, PROBLEM),
    "BoundaryValueProblem.solve": (
        lambda: BoundaryValueProblem(**PROBLEM).solve,
        {"guess": [0.0, 1.0], "tolerance": 1e-4, "transcription": "gauss", "degree": 3, "corrector": "newton",
         "intervals": 4},
    ),
    "BoundaryValueProblem.with_parameters": (lambda: BoundaryValueProblem(**PROBLEM).with_parameters, {"mu": 1.0}),
    "find_equilibrium": (
        lambda: find_equilibrium,
        {"model": VAN_DER_POL, "guess": [0.1, 0.0], "parameters": {"mu": 0.1}, "transient": None, "tolerance": 1e-8,
         "corrector": "newton"},
    ),
    "find_equilibria": (
        lambda: find_equilibria,
        {"model": VAN_DER_POL, "bounds": {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, "starts": 2, "seed": 0,
         "parameters": {"mu": 0.1}, "tolerance": 1e-8, "corrector": "newton"},
    ),
    "find_orbit": (
        lambda: find_orbit,
        {
            "model": VAN_DER_POL, "guess": circle, "period": 6.3, "parameters": {"mu": 0.1}, "select": None,
            "section": Y, "symmetric": False, "cycles": 1, "free": (), "bounds": None, "objective": None,
            "running": None, "tolerance": 1e-3, "corrector": "newton",
        },
    ),
    "follow_family": (
        lambda: follow_family,
        {"model": CHAIN, "mode": 1, "amplitude_max": 0.5, "at": (0.2,), "at_Omega": (), "at_period": (),
         "period_max": None, "max_points": 4, "until": None, "stability": False, "events": False, "tolerance": 1e-4,
         "parameters": None, "progress": None, "corrector": "newton"},
    ),
    "optimise": (
        lambda: optimise,
        {"quantity": "Omega", "of": None, "over": ("S",), "bounds": {"S": (0.1, 0.2)}, "subject_to": (),
         "maximise": False, "starts": 1, "seed": 0, "progress": None, "tolerance": 1e-4},
    ),
    "pareto_front": (
        lambda: pareto_front,
        {"first": "Omega", "second": "S", "of": None, "over": ("S",), "points": 2, "starts": 1, "seed": 0,
         "tolerance": 1e-4, "subject_to": (), "bounds": {"S": (0.1, 0.2)}},
    ),
    "fit_parameters": (
        lambda: fit_parameters,
        {"measured": None, "over": ("gamma",), "bounds": {"gamma": (0.1, 0.4)}, "progress": None},
    ),
    "search_orbit": (
        lambda: search_orbit,
        {"model": VAN_DER_POL, "objective": "period", "running": None, "free": ("mu",),
         "bounds": {"mu": (0.05, 0.1)}, "constraints": (), "starts": 1, "guess": circle, "period": 6.3, "select": None,
         "section": None, "symmetric": False, "cycles": 1, "parameters": {"mu": 0.1}, "tolerance": 1e-3,
         "intervals": 10},
    ),
    "simulate": (
        lambda: simulate,
        {"model": VAN_DER_POL, "start": [1.0, 0.0], "t": [0.0, 0.5, 1.0], "parameters": None, "tolerance": 1e-4},
    ),
    "evolve": (
        lambda: evolve,
        {"model": CHAIN, "positions": [0.1, 0.0], "velocities": None, "t": [0.0, 0.5], "method": "cvodes",
         "tolerance": 1e-6, "coordinates": None, "step": None, "parameters": None},
    ),
    "initial_state": (
        lambda: initial_state,
        {"model": CHAIN, "size": 0.1, "mode": 1, "site": None, "vector": None, "seed": None, "moving": False,
         "parameters": None},
    ),
    "perturbed": (lambda: perturbed, {"orbit": None, "size": 0.1, "site": 1, "vector": None, "seed": None}),
    "simulate_orbit": (
        lambda: simulate_orbit,
        {"orbit": None, "t": [0.0, 0.5], "size": 0.1, "site": 1, "vector": None, "seed": None, "method": "cvodes",
         "tolerance": 1e-6, "coordinates": None},
    ),
    "distance_from_orbit": (lambda: distance_from_orbit, {"orbit": None, "evolution": evolution()}),
    "spreading": (lambda: spreading, {"evolution": evolution()}),
    "conservative_part": (lambda: conservative_part, {"lattice": DRIVEN}),
    "energy_balance": (lambda: energy_balance, {"lattice": DRIVEN, "orbit": None}),
    "resonances": (
        lambda: resonances,
        {"lattice": DRIVEN, "mode": 1, "amplitude_max": 0.05, "frequency": "w", "tolerance": 1e-4},
    ),
    "lattice_modes": (lambda: lattice_modes, {"lattice": DRIVEN, "parameters": None}),
    "bands": (lambda: bands, {"lattice": DRIVEN, "parameters": None, "points": 5, "open_ends": False}),
    "brillouin_zone": (lambda: brillouin_zone, {"lattice": DRIVEN, "squares": [1.0, 2.0], "parameters": None}),
    "winding_numbers": (lambda: winding_numbers, {"lattice": DRIVEN, "squares": [1.0, 2.0], "parameters": None}),
    "harmonic_shares": (lambda: harmonic_shares, {"orbit": None, "coordinates": "gauge"}),
    "third_harmonic_leads": (lambda: third_harmonic_leads, {"branch": branch(), "coordinates": "gauge"}),
    "smallest_kick": (
        lambda: smallest_kick,
        {"orbit": None, "time": 1.0, "distance": 0.5, "norm": "physical", "sites": None, "starts": 1, "seed": 0,
         "progress": None, "workers": 1, "executor": None},
    ),
    "export_c": (
        lambda: export_c,
        {"source": SPRING, "path": "c", "what": ("rhs",), "name": None, "harmonics": 4},
    ),
    "build_c": (lambda: build_c, {"path": "missing", "compiler": None}),
    "export_fmu": (
        lambda: export_fmu,
        {"source": SPRING, "path": "spring.fmu", "fmi": "3.0", "start": None, "mode": None, "S": None, "stop_time": 1.0,
         "tolerance": 1e-4, "binary": False},
    ),
    "import_fmu": (
        lambda: import_fmu,
        {"path": "missing.fmu", "states": None, "parameters": (), "forcing_period": None, "time_limit": 5.0},
    ),
    "import_co_simulation": (
        lambda: import_co_simulation,
        {"path": "missing.fmu", "states": None, "parameters": (), "inputs": None, "forcing_period": None, "step": 0.1,
         "starts": None, "solver_tolerance": 1e-4, "time_limit": 5.0},
    ),
    "run_map": (
        lambda: run_map,
        {"scene": "missing.toml", "path": "map", "workers": 1, "scheduler": None, "executor": None, "part": None,
         "collect": False, "resume": False, "overwrite": False, "pictures": False, "quiet": True},
    ),
    "save_model": (lambda: save_model, {"model": SPRING, "path": "spring.json"}),
    "read_map": (lambda: read_map, {"path": "map"}),
    "read_model": (lambda: read_model, {"path": "spring.json"}),
    "save_result": (lambda: save_result, {"result": branch(), "path": "branch.skin"}),
    "read_result": (lambda: read_result, {"path": "branch.skin"}),
    "SymmetryClass": (lambda: SymmetryClass, {"value": 0.25}),
    "Orbit": (lambda: Orbit, {"space": None, "point": None, "exact": {}, "optimum": None, "known_floquet": None}),
    "Orbit.evaluate": (lambda: orbit().evaluate, {"t": [0.0, 1.0], "sites": None}),
    "Orbit.coefficients": (lambda: branch().orbits[-1].coefficients, {"harmonics": 3, "sites": None}),
    "Orbit.log10_displacements": (lambda: branch().orbits[-1].log10_displacements, {"sites": None}),
    "Orbit.floquet": (lambda: orbit().floquet, {"flow": None}),
    "Orbit.transient_growth": (lambda: branch().orbits[-1].transient_growth, {"quarters": 2}),
    "Orbit.follow": (
        lambda: find_orbit(VAN_DER_POL, circle, 6.3, tolerance=1e-2, corrector="newton").follow,
        {"parameter": "mu", "to": 0.11, "at": (), "max_points": 3, "max_step": 0.2, "until": None, "stability": False,
         "events": True, "progress": None},
    ),
    "BoundaryValueProblem.solve().follow": (
        lambda: solution().follow,
        {"parameter": "mu", "to": 1.1, "at": (), "max_points": 3, "max_step": 0.2, "until": None, "stability": False,
         "events": True, "progress": None},
    ),
    "BoundaryValueProblem.solve().evaluate": (lambda: solution().evaluate, {"t": [0.0, 1.0]}),
    "Branch": (
        lambda: Branch,
        {"space": None, "solutions": (), "with_stability": False, "end": None, "detail": "", "stopped": False},
    ),
    "Branch.at": (lambda: branch().at, {"value": 0.04, "which": 0}),
}  # fmt: skip


PLAIN = (int, float, str, bytes, type(None))


class Broken:
    """An object that cannot even be shown."""

    def __repr__(self) -> str:
        raise RuntimeError("no text")


def fails(*arguments: Any) -> Any:
    raise AttributeError("what a user's function may raise")


def values(draw: random.Random) -> Any:
    """Anything that a script may give by mistake, or on purpose."""
    mx = ca.MX.sym("m", draw.choice([1, 2]))
    pool: list[Any] = [
        None, True, False, 0, 1, -1, 3, 2.0, 0.25, -0.5, 1e308, 5e-324, float("nan"), float("inf"), 10**400, 1j, "",
        "x", "mu", "period", "S", "a\nb", "first", "newton", b"x", [], (), {}, set(), [1.0], [0.0, 1.0],
        (1.0, 2.0, 3.0), ["x"], ["mu"], [None], [[1.0, 2.0], [3.0, 4.0]], [[1.0], [2.0, 3.0]], {"mu": 1.0},
        {"x": 0.5}, {"x": "y"}, {1: 2}, {"S": 3}, np.array(1.0), np.array([1.0, 2.0]), np.ones((2, 3)),
        np.ones((3, 2)), np.array([np.nan, 1.0]), np.array(["a"]), np.array([X, Y]), np.zeros(0), np.float64(0.3),
        np.int64(2), np.bool_(True), ca.SX(1.0), ca.SX(2, 1), X, Y, MU, Q, V, ca.vertcat(X, Y), ca.horzcat(X, Y),
        X == 1, X + ca.SX.sym("stranger"), [X, Y], [X], (X * Y, 1.0), [ca.SX(1), 2], [[X], [Y]], mx, mx * 2,
        ca.MX(1.0), ca.DM([1.0, 2.0]), ca.DM(3.0), ca.Sparsity.dense(2, 2), VAN_DER_POL, SPRING, FORCED, CHAIN,
        OdeModel, Chain, int, object(), Broken(), fails, len, circle, lambda: 1.0, lambda t: None, lambda t: [t, "a"],
        lambda t, x, p: [x[1], -x[0]] if x.numel() > 1 else -x, lambda t, x, p: None, lambda *a: X,
        ca.Function("f", [T, ca.vertcat(X, Y), MU], [Y]), (np.linspace(0, 6, 9), np.ones((9, 2))),
        (np.linspace(0, 6, 9), np.ones((2, 9))), (np.linspace(0, 6, 9), np.ones((3, 9))),
        ([0.0, 1.0], [[1.0], [2.0]]), (0.0, 1.0), (1.0, 0.0), (X, 1.0), (None, None), {"mu": (0.0, 1.0)},
        {"mu": (1.0, 0.0)}, {"x": (0.0, None)}, {"period": (1.0, 9.0)}, ("mu",), ("mu", "mu"), SymmetryClass.HALF,
        iter([1.0]), range(3), slice(None), Path("p"), Path("/dev/null/x"), "\0", "spring.json",
    ]  # fmt: skip
    if draw.random() < 0.15:
        return [values(draw) for _ in range(draw.randint(0, 3))]
    if draw.random() < 0.1:
        return {draw.choice(["mu", "x", "y", "c", "S", "period"]): values(draw) for _ in range(2)}
    return draw.choice(pool)


def fill(name: str, given: dict[str, Any]) -> None:
    """Give a call the orbits that it is for, which are solved where they are needed."""
    orbit = branch().orbits[-1]
    given |= {key: orbit for key in ("of", "orbit") if key in given}
    if name == "fit_parameters":
        given["measured"] = [(orbit, "Omega", orbit.Omega, 0.1)]


def called(name: str, draw: random.Random, folder: Path) -> tuple[Callable[[], Any], str]:
    """A call of a public name with one to three arguments replaced, left out or added, and what it says in words."""
    make, right = CALLS[name]
    given = dict(right)
    if isinstance(given.get("path"), str):
        given["path"] = str(folder / given["path"])
    fill(name, given)
    for _ in range(draw.randint(1, 3) if draw.random() < 0.4 else 1):
        key = draw.choice(list(given))
        kind = draw.random()
        if kind < 0.06:
            given.pop(key)
            if not given:
                break
        elif kind < 0.1 and name != "SymmetryClass":  # which Python takes to make another one, with more arguments
            given[draw.choice(["nonsense", "tolerance", "flow", "walker", "tail", "degree", "symmetry"])] = values(draw)
        else:
            value = values(draw)
            users = callable(value) and key in ("until", "progress")  # what it raises is what the user gets
            plain = name != "SymmetryClass" or isinstance(value, PLAIN)  # Python's own look-up compares and hashes
            given[key] = value if plain and not users else "x"
    function, place = make(), draw.randint(0, min(2, len(given))) if draw.random() < 0.2 else 0
    ordered = [*given.values()][:place]
    rest = dict(list(given.items())[place:])
    return (lambda: function(*ordered, **rest)), f"{name}(*{place}, {sorted(rest)})"


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Stop what takes longer, as Ctrl-C would."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def check(name: str, seed: int, folder: Path) -> bool:
    """Whether the call was refused; raises AssertionError where it was otherwise than documented."""
    call, words = called(name, random.Random(seed), folder)
    error = outcome(call)
    if error is None:
        return False
    what = f"{words}, seed {seed}: {type(error).__name__}: {error}"
    assert isinstance(error, DOCUMENTED), what
    message = str(error)
    assert "\n" not in message, what
    assert 0 < len(message) < 700, what
    of_signature = isinstance(error, TypeError) and "()" in message and "argument" in message
    told = any(
        word in message for word in ("accepted: ", ": given ", "cannot be read", " needs ", " fails: ", "spring: ")
    )
    assert told or of_signature or isinstance(error, ArithmeticError | OSError), what
    return True


def outcome(call: Callable[[], Any]) -> Exception | None:
    try:
        with at_most(LONGEST):
            call()
    except Exception as error:
        return error
    return None


def test_every_public_name_is_called() -> None:
    called = {name.partition(".")[0].partition(" ")[0] for name in CALLS}
    assert called == {name for name in casadi_skin.__all__ if not is_made_here(getattr(casadi_skin, name))}


def is_made_here(public: Any) -> bool:
    """Whether a public name is no function and no class that a script calls: results but two, exceptions, modules."""
    if isinstance(public, type):
        return issubclass(public, Result | casadi_skin.Map | Exception) and public not in (Orbit, Branch)
    return public is casadi_skin.style or not callable(public)


@pytest.mark.slow
def test_the_calls_to_mutate_are_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    needs = (
        "build_c",
        "import_co_simulation",
        "import_fmu",
        "read_map",
        "run_map",
        "smallest_kick",
    )  # files, or a stable orbit
    for name in (name for name in CALLS if name not in needs):
        make, right = CALLS[name]
        given = dict(right)
        fill(name, given)
        make()(**given)


@pytest.mark.parametrize("count", [8, pytest.param(180, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", sorted(CALLS))
def test_random_arguments_are_taken_or_refused_as_documented(
    name: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some 230 calls in a quick run, more than 5,000 in a slow one."""
    monkeypatch.chdir(tmp_path)
    refused = sum(check(name, seed, tmp_path) for seed in range(count))
    assert refused > 0 or name in ("Orbit", "Branch")  # which hold what they are given
