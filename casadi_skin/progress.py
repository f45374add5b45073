"""Progress of long work on a terminal; silent elsewhere."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from casadi_skin.orbits.orbit import Orbit

if TYPE_CHECKING:
    from rich.status import Status


class Progress:
    """One line on standard error that tells family, S, points and step; only on a terminal and unless `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        from rich.console import Console

        console = Console(stderr=True)
        shown = console.is_terminal and not quiet
        self._status: Status | None = console.status("building", spinner="line") if shown else None

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def orbit(self, orbit: Orbit, points: int) -> None:
        """Tell that an orbit has been reached."""
        if self._status is not None:
            request, step = orbit.space.request, orbit.point.step
            self._status.update(
                f"j = {request.mode}: S = {orbit.S:.6g} of {request.amplitude_max:g}, {points} points, step {step:.2g}"
            )

    def say(self, words: str) -> None:
        """Tell what is being done now."""
        if self._status is not None:
            self._status.update(words)
