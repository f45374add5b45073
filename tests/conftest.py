"""What every test may rely on: one thread a process, no window, signals as in a terminal."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import nullcontext

import pytest
from drawing import blank_pictures
from hypothesis import settings

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")  # each core has a worker of its own
os.environ.setdefault("MPLBACKEND", "Agg")

from apart import cli as cli
from kernels import needs_kernels, numpy_alone  # numpy is imported with them, which reads these
from outputs import run_example as run_example
from scenes import run as run

from casadi_skin.follow import family
from casadi_skin.model.interrupts import ENDING

if os.name != "posix":  # limits, locks and signals that Windows has not; benchmarks ask for peak memory
    collect_ignore_glob = [
        "benchmarks/*", "end_to_end/test_faults.py", "hostile/test_l*.py", "hostile/test_signals.py",
        "unit/test_hostile_fmus.py", "unit/test_locking.py",
    ]  # fmt: skip


@pytest.hookimpl(optionalhook=True)  # tests run without pytest-xdist too, one after the other
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One worker a core; none for a single file, which ends sooner without, and for benchmarks, which take times."""
    files = {argument.split("::")[0] for argument in config.args}
    alone = len(files) == 1 and files.pop().endswith(".py")
    return 0 if alone or config.option.markexpr == "benchmark" else None


def slow_run(config: pytest.Config) -> bool:
    return "slow" in config.option.markexpr.replace("not slow", "")


def pytest_configure(config: pytest.Config) -> None:
    if os.environ.get("CI"):  # a warning of a version that somebody else has is no failure of theirs
        config.addinivalue_line("filterwarnings", "error")
    config.addinivalue_line("filterwarnings", "ignore::DeprecationWarning:casadi.*")
    settings.register_profile("quick", max_examples=20, deadline=None, derandomize=True, database=None)
    settings.register_profile("slow", max_examples=100, deadline=None, derandomize=True, database=None)
    settings.register_profile("random", max_examples=300, deadline=None)  # looks for new faults
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "slow" if slow_run(config) else "quick"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Properties are tried in quick runs on a few examples, the same every time, and in slow runs on more."""
    for item in items:
        if slow_run(config) and getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
            item.add_marker("slow")
    # Of a test that is slow by itself the quick variants of a fixture are left out: the long ones hold all of them.
    short = [item for item in items if item.get_closest_marker("slow") and _is_short(item)]
    config.hook.pytest_deselected(items=short)
    items[:] = [item for item in items if item not in short]


@pytest.fixture(scope="session", autouse=True)
def compiler_of_quick_runs(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Quick runs compile generated C without optimising it, in a quarter of the time; benchmarks take times."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    with pytest.MonkeyPatch.context() as patch:
        takes_times = pytestconfig.option.markexpr == "benchmark"
        scripts = os.name == "posix"  # Windows starts none in the place of a program
        if scripts and compiler is not None and not slow_run(pytestconfig) and not takes_times:
            script = tmp_path_factory.mktemp("compiler") / "cc"
            script.write_text(f'#!/bin/sh\nexec {compiler} "$@" -O0\n', encoding="utf-8")
            script.chmod(0o755)
            patch.setenv("CC", str(script))
        yield


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Signals as in a terminal, for the test and its child processes: a background job ignores SIGINT."""
    handlers = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(ENDING[1:], signal.SIG_DFL)}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _is_short(item: pytest.Item) -> bool:
    """Whether a fixture with a quick and a long variant is the quick one."""
    params = getattr(getattr(item, "callspec", None), "params", {})
    return params.get("pictures") == "blank" or params.get("harmonics") == "few"


@pytest.fixture(params=["blank", pytest.param("drawn", marks=pytest.mark.slow)])
def pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blank in the quick run of a test that is of something else, drawn in the slow run."""
    if request.param == "blank":
        blank_pictures(monkeypatch)


@pytest.fixture(params=[pytest.param("compiled", marks=needs_kernels), "numpy"])
def way(request: pytest.FixtureRequest) -> Iterator[None]:
    """By the compiled kernels, and by numpy as in a package without them."""
    with numpy_alone() if request.param == "numpy" else nullcontext():
        yield


@pytest.fixture
def blank(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of a test that asks for other files: written without being drawn, in quick and slow runs.

    In a module whose tests are such, one that asks for `pictures` too draws them.
    """
    if "pictures" not in request.fixturenames:
        blank_pictures(monkeypatch)


@pytest.fixture(params=["few", pytest.param("all", marks=pytest.mark.slow)])
def harmonics(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """In quick tests at most 48 harmonics: families of which the period grows without bound run out of them soon."""
    if request.param == "few":
        monkeypatch.setattr(
            family, "HARMONICS_OFFERED", tuple(count for count in family.HARMONICS_OFFERED if count <= 48)
        )
        monkeypatch.setattr(family, "MANY_HARMONICS", ())
