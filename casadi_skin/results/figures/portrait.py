"""Several solutions of one model side by side: their phase portrait, and a state over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.results.figures.branch import times
from casadi_skin.results.figures.style import DASHES, blank, colours, finished, plain, style
from casadi_skin.results.figures.style import title as model_title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 6  # solutions that are drawn
CHOSEN = 4  # orbits of a branch, by default


def portrait_figure(solutions: Sequence[Solution], title: str = "", states: tuple[int, int] = (0, 1)) -> Figure:
    """Orbits and equilibria in the plane of two states, and the first of these against time.

    Arguments:
        solutions: one to six of one model.
        title: stands in place of the name of the model.
        states: places of the two states among their names, from 0; of one state alone time courses are drawn.

    Returns:
        The figure; solutions are labelled by the parameters in which they differ.

    Raises:
        ValueError: there are no solutions, or more than six.
    """
    if not 1 <= len(solutions) <= MOST:
        raise ValueError(f"solutions: given {len(solutions)}; accepted: 1 to {MOST}")
    names = solutions[0].space.state_names
    in_plane = len(names) > 1
    words, common = _words(solutions)
    longest = max((s.interval[1] for s in solutions), default=0.0) or 1.0
    with style():
        figure = blank(8.0 if in_plane else 5.0, 3.8)
        axes = figure.subplots(1, 1 + in_plane, squeeze=False)[0]
        for solution, colour, dashes, label in zip(solutions, colours(len(solutions)), DASHES, words, strict=False):
            at_rest = isinstance(solution, Equilibrium)
            t = np.array([0.0, longest]) if at_rest else times(solution)
            x = solution.evaluate(t)
            axes[0].plot(t, x[:, states[0]], color=colour, ls=dashes, lw=1.4, label=label)
            if in_plane:
                look = {"marker": "o", "ms": 5, "mec": "black", "ls": "none"} if at_rest else {"ls": dashes, "lw": 1.4}
                axes[1].plot(*x[:, list(states)].T, color=colour, label=label, **look)
        axes[0].set(xlabel="t", ylabel=plain(names[states[0]]))
        if in_plane:
            axes[1].set(xlabel=plain(names[states[0]]), ylabel=plain(names[states[1]]))
        figure.suptitle(model_title(solutions[0].space.model, common, title))
        return finished(figure, axes, 3, plain=True)


def chosen_solutions(branches: Sequence[Branch]) -> list[Solution]:
    """Solutions for a portrait: the requested ones, else an equilibrium where cycles are born and a few of these.

    None where no orbit is among the branches: equilibria alone are seen in the diagram.
    """
    held = [s for branch in branches for s in branch.solutions]
    requested = [s for s in held if s.point.requested]
    cycles = next((branch.solutions for branch in branches if isinstance(branch.solutions[0], Orbit)), ())
    if requested and cycles:
        return requested[:MOST]
    moving = [s for s in cycles[1:] if not s.point.special]  # the first one has no amplitude
    places = np.unique(np.linspace(0, len(moving) - 1, CHOSEN + 1)[1:].astype(int)) if moving else ()
    born = [s for s in held if s.point.special == "hopf" and isinstance(s, Equilibrium)][:1]
    return [*born, *(moving[place] for place in places)] if moving else []


def _words(solutions: Sequence[Solution]) -> tuple[list[str], dict[str, float]]:
    """A label for each solution, by the parameters in which they differ, and the parameters that they share."""
    first = solutions[0].parameters
    shared = {
        name: value
        for name, value in first.items()
        if all(name in s.parameters and s.parameters[name] == value for s in solutions)
    }
    labels = []
    for solution in solutions:
        own = {name: value for name, value in solution.parameters.items() if name in first and name not in shared}
        values = ", ".join(f"{plain(name)} = {value:.4g}" for name, value in own.items())
        period = f", period {solution.period:.4g}" if isinstance(solution, Orbit) else ", at rest"
        labels.append(f"{values}{period}".removeprefix(", "))
    return labels, shared
