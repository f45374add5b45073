"""Progress of long work on a terminal; silent elsewhere."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from casadi_skin.follow.solution import Solution

if TYPE_CHECKING:
    from rich.status import Status


class Progress:
    """One line on standard error with the place on a branch, points and step; only on a terminal and unless `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet, self.on_terminal = quiet, not quiet and sys.stderr.isatty()
        self._status: Status | None = None
        if self.on_terminal:  # rich takes time to load
            from rich.console import Console

            self._status = Console(stderr=True).status("building", spinner="line")

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the line off the terminal."""
        if self._status is not None:
            self._status.stop()

    def solution(self, solution: Solution, points: int) -> None:
        """Show that a solution has been reached, with its number on the branch."""
        if self._status is not None:
            self._status.update(f"{_place(solution)}, {points} points, step {solution.point.step:.2g}")

    def report(self, words: str) -> None:
        """Leave a line on standard error, unless quiet."""
        if not self._quiet:
            print(f"casadi-skin: {words}", file=sys.stderr)

    def say(self, words: str) -> None:
        """Show the present step."""
        if self._status is not None:
            self._status.update(words)


def _place(solution: Solution) -> str:
    """Place of a solution on its branch, and the end of the branch."""
    space: Any = solution.space
    if space.is_family:
        S, end = space.value("S", solution.point), space.request.amplitude_max
        return f"j = {space.coordinates.mode_number}: S = {S:.6g} of {end:g}"
    if space.parameter:
        return f"{space.parameter} = {solution.parameters[space.parameter]:.6g} on the way to {space.to:g}"
    return "solved"
