"""Results that threads share: eight at once find the bytes of one, a forked process can compute, an interrupt ends one.

What one thread finds is found on results of its own, so that nothing is known before the eight begin. Without the lock
these tests fail, wait without end or end the process in most of their runs, but for an equilibrium, a model
and saving: CasADi gives each call of a function and each integrator memory of its own, and what is saved is known.
"""

from __future__ import annotations

import _thread
import multiprocessing
import os
import pickle
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import casadi as ca
import matplotlib
import matplotlib.style
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from matplotlib.figure import Figure

import casadi_skin
from casadi_skin import (
    Branch,
    Chain,
    OdeModel,
    Orbit,
    find_equilibrium,
    find_orbit,
    follow_family,
    optimise,
    read_result,
    save_result,
    simulate,
)
from casadi_skin.model.result import TURN
from casadi_skin.results.figures.style import style

THREADS = 8
LIMIT = 300.0  # seconds after which threads are taken to wait for each other
CHAIN = Chain(6, 1.0, 0.25, -1.0)


@pytest.fixture(params=[pytest.param(True, id="kernels", marks=needs_kernels), pytest.param(False, id="numpy")])
def _kernels(request: pytest.FixtureRequest) -> Iterator[None]:
    with nullcontext() if request.param else numpy_alone():
        yield


@pytest.fixture(autouse=True)
def _often() -> Iterator[None]:
    """Threads give way to each other a hundred times as often as they do."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(5e-5)
    yield
    sys.setswitchinterval(before)


def together(*works: Callable[[], Any]) -> list[Any]:
    """What each finds in a thread of its own, all of which begin at once."""
    found: list[Any] = [None] * len(works)
    begin = threading.Barrier(len(works))

    def work(k: int) -> None:
        begin.wait()
        try:
            found[k] = works[k]()
        except BaseException as error:
            found[k] = error

    threads = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(len(works))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT)
        assert not thread.is_alive()
    for each in found:
        if isinstance(each, BaseException):
            raise each
    return found


def van_der_pol() -> OdeModel:
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    return OdeModel("oscillator", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu, nominal=(1.0,))


def cycle() -> Orbit:
    return find_orbit(van_der_pol(), lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6, parameters={"mu": 1.0})


def rest() -> Any:
    x, y, p = (ca.SX.sym(name) for name in ("x", "y", "p"))
    rate = p * (1 - x) * ca.exp(y)
    model = OdeModel("reactor", ca.vertcat(x, y), ca.vertcat(-x + rate, -y + 14 * rate - 2 * y), p, nominal=(0.0,))
    return find_equilibrium(model, [0.0, 0.0])


def family(**options: Any) -> Branch:
    return follow_family(CHAIN, 1, 1.5, at=(0.5,), **options)


def rows(branch: Branch, *names: str) -> list[bytes]:
    return [np.asarray(branch[name]).tobytes() for name in names]


def points(branch: Branch) -> list[Any]:
    return [(point.kind, tuple(point.parameters.items()), point.error) for point in branch.special_points]


def changes(branch: Branch) -> list[str]:
    return [repr(change) for change in branch.changes]


def multipliers(branch: Branch) -> list[bytes]:
    return [orbit.floquet().multipliers.tobytes() for orbit in branch]


# Eight threads: what is shared is made by the first function, what each finds in it by the others in turn -------------


def at(place: float) -> Callable[[Branch], bytes]:
    return lambda branch: branch.at(S=place).states.tobytes()


def rests(branch: Branch) -> list[bytes]:
    return [branch.at(p=p).state.tobytes() for p in (0.02, 0.05, 0.2)]


def cycles(branch: Branch) -> list[bytes]:
    point = next(point for point in branch.special_points if point.kind == "hopf")
    return rows(point.follow("p", 0.2), "period")


def evolved(model: OdeModel) -> bytes:
    return bytes(simulate(model, [2.0, 0.0], np.linspace(0.0, 20.0, 11)).states.tobytes())


def designed(chain: Chain) -> tuple[float, ...]:
    bounds = {"S": (0.1, 1.0), "gamma": (0.0, 0.3)}
    orbit = follow_family(chain, "last", 1.0).orbits[-1]
    best = optimise("Omega", orbit, over=("S", "gamma"), bounds=bounds)
    return best.value, best["S"], best["gamma"]


def proved(orbit: Orbit) -> str:
    return repr(orbit.certify())


def drawn(branch: Branch) -> list[bytes]:
    return [line.get_xydata().tobytes() for line in branch.plot(Figure().subplots()).lines]


SHARED: dict[str, tuple[Callable[[], Any], tuple[Callable[[Any], Any], ...]]] = {
    "orbits of a family": (family, tuple(at(place) for place in np.linspace(0.2, 1.2, THREADS))),
    "an orbit": (cycle, (lambda orbit: rows(orbit.follow("mu", 2.0, stability=True), "period", "mu"),)),
    "an equilibrium": (rest, (lambda one: points(one.follow("p", 0.25)),)),
    "a branch of orbits": (
        lambda: family(stability=True),
        (changes, multipliers, drawn, *(at(place) for place in (0.3, 0.4, 0.6, 0.8, 0.9))),
    ),
    "a branch of equilibria": (lambda: rest().follow("p", 0.25), (points, drawn, rests, cycles)),
    "a model": (van_der_pol, (evolved,)),
    "a chain": (lambda: Chain(4, 1.0, 0.25, 1.0), (designed,)),
}


QUICK = ("orbits of a family", "a model")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SHARED]
)
@pytest.mark.usefixtures("_kernels")
def test_eight_threads_find_the_bytes_of_one(name: str) -> None:
    made, works = SHARED[name]
    expected = [work(made()) for work in works]
    shared, places = made(), [k % len(works) for k in range(THREADS)]
    found = together(*(lambda work=works[k]: work(shared) for k in places))  # type: ignore[misc]
    for k, each in zip(places, found, strict=True):
        assert each == expected[k]


def test_eight_threads_prove_one_orbit() -> None:
    pytest.importorskip("flint")
    orbit = family(tolerance=1e-10).at(S=0.5)
    expected = proved(family(tolerance=1e-10).at(S=0.5))
    assert together(*[lambda: proved(orbit)] * THREADS) == [expected] * THREADS


def test_eight_threads_save_one_branch(tmp_path: Path) -> None:
    def written(branch: Branch, number: int) -> bytes:
        path = tmp_path / f"{number}.result"
        save_result(branch, path)
        assert read_result(path).Omega.tobytes() == branch.Omega.tobytes()
        return path.read_bytes()

    expected, branch = written(family(stability=True), THREADS), family(stability=True)
    found = together(*(lambda k=k: written(branch, k) for k in range(THREADS)))  # type: ignore[misc]
    assert set(found) == {expected}


def test_eight_threads_leave_the_settings_of_matplotlib_alone() -> None:
    def settled() -> None:
        for _ in range(5):
            with style():
                time.sleep(0.001)

    before = dict(matplotlib.rcParams)
    together(*[settled] * THREADS)
    assert dict(matplotlib.rcParams) == before


# While another thread computes ----------------------------------------------------------------------------------------


@pytest.fixture
def busy() -> Iterator[Branch]:
    """A family along which four other threads compute."""
    branch, stop = family(), threading.Event()

    def work(place: float) -> None:
        while not stop.is_set():
            branch.at(S=place)

    threads = [threading.Thread(target=work, args=(place,)) for place in (0.3, 0.5, 0.9, 1.1)]
    for thread in threads:
        thread.start()
    yield branch
    stop.set()
    for thread in threads:
        thread.join(LIMIT)
        assert not thread.is_alive()


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_process_forked_meanwhile_computes(busy: Branch) -> None:
    expected, context = family().at(S=0.7).states.tobytes(), multiprocessing.get_context("fork")

    def child(answer: Any) -> None:
        own, other = busy.at(S=0.7).states.tobytes(), together(lambda: busy.at(S=0.7).states.tobytes())
        answer.send((own, other[0]))

    for _ in range(10):
        here, there = context.Pipe()
        process = context.Process(target=child, args=(there,))
        process.start()
        assert here.poll(LIMIT)
        assert here.recv() == (expected, expected)
        process.join(LIMIT)
        assert process.exitcode == 0


@pytest.mark.skipif(signal.getsignal(signal.SIGINT) is signal.SIG_IGN, reason="interrupts are ignored, as behind nohup")
def test_an_interrupt_ends_the_main_thread_alone(busy: Branch) -> None:
    def on_and_on() -> None:
        while True:
            assert busy.at(S=0.7).states.tobytes() == expected

    expected = family().at(S=0.7).states.tobytes()
    threading.Timer(0.5, _thread.interrupt_main).start()
    with pytest.raises(KeyboardInterrupt):
        on_and_on()
    assert busy.at(S=0.7).states.tobytes() == expected


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="the system has no timers")
def test_interrupts_of_the_style_leave_the_turn_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    # What takes most of the time is left out: interrupts come as the turn begins or ends, from 3.14 on in between, too.
    monkeypatch.setattr(matplotlib.style, "context", lambda *_, **__: nullcontext())
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    for delay in np.linspace(1e-5, 2e-3, 100):
        with suppress(KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, delay)
            for _ in range(20_000):
                with style():
                    pass
    signal.signal(signal.SIGALRM, before)
    assert together(lambda: TURN.acquire(timeout=1.0) and TURN.release() is None) == [True]


# Whatever is public ---------------------------------------------------------------------------------------------------

# Cells of maps take turns one by one; the others read no result and no model, but arrays, or text for a compiler.
# The style takes its turn when it is entered.
WITHOUT_TURN = ("run_map", "write_netcdf", "write_csv", "build_c", "style")
NAMED = re.compile(r"^::: casadi_skin[.]([\w.]+)[.](\w+)$", re.MULTILINE)


def documented() -> Iterator[tuple[str, str]]:
    """Modules and names in them that the reference has."""
    for page in (Path(__file__).parents[2] / "docs").glob("reference_*.md"):
        yield from NAMED.findall(page.read_text(encoding="utf-8"))


def public_functions() -> dict[str, FunctionType]:
    """Those of the package, and those that the reference documents in its modules."""
    found = {f"casadi_skin.{name}": getattr(casadi_skin, name) for name in casadi_skin.__all__}
    for module, name in documented():
        if not module.rpartition(".")[2][0].isupper():  # no methods
            found[f"casadi_skin.{module}.{name}"] = getattr(import_module(f"casadi_skin.{module}"), name, None)
    return {name: value for name, value in found.items() if isinstance(value, FunctionType)}


def test_every_public_function_waits_for_its_turn() -> None:
    def without_arguments(function: Callable[[], Any]) -> None:
        with pytest.raises(TypeError, match="missing"):
            function()

    functions = {n: f for n, f in public_functions().items() if n.rpartition(".")[2] not in WITHOUT_TURN}
    assert len(functions) > 60
    threads = {n: threading.Thread(target=without_arguments, args=(f,)) for n, f in functions.items()}
    with TURN:
        for thread in threads.values():
            thread.start()
        time.sleep(0.5)
        assert not [name for name, thread in threads.items() if not thread.is_alive()]
    for thread in threads.values():
        thread.join(LIMIT)
        assert not thread.is_alive()


def test_public_functions_are_found_again_when_they_are_pickled() -> None:
    for function in public_functions().values():
        assert pickle.loads(pickle.dumps(function)) is function
