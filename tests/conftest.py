"""What every test may rely on: one thread a process, no window, signals as in a terminal."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: each core has a worker of its own
os.environ.setdefault("MPLBACKEND", "Agg")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One worker a core; none for a single file, which ends sooner without, and for benchmarks, which take times."""
    files = {argument.split("::")[0] for argument in config.args}
    alone = len(files) == 1 and files.pop().endswith(".py")
    return 0 if alone or config.option.markexpr == "benchmark" else None


@pytest.fixture
def interruptible() -> Iterator[None]:
    """SIGINT and SIGTERM as in a terminal, for the test and its child processes: a background job ignores SIGINT."""
    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler if handler is not None else signal.SIG_DFL)


@pytest.fixture(params=["blank", pytest.param("drawn", marks=pytest.mark.slow)])
def pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty files in place of pictures in quick tests of something else: drawing takes nine tenths of a small run."""
    if request.param == "blank":
        blank_pictures(monkeypatch)


def blank_pictures(patch: pytest.MonkeyPatch) -> None:
    def write(drawn: Any, path: object, **__: object) -> None:
        if isinstance(path, (str, Path)):
            Path(path).touch()
        drawn._draw_was_started = True  # a film that was not drawn warns

    patch.setattr("matplotlib.figure.Figure.savefig", write)
    patch.setattr("matplotlib.animation.Animation.save", write)
    patch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
