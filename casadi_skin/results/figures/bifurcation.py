"""Bifurcation diagrams: branches of equilibria and cycles against a parameter; curves in two parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import band_edges, lattice_modes
from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.results.figures.branch import (
    LOOKS,
    MARKS,
    PLAIN,
    draw_lines,
    draw_marks,
    label_of,
    smooth,
    stability_pieces,
)
from casadi_skin.results.figures.multipliers import frequency_pieces, shade_unresolved
from casadi_skin.results.figures.style import (
    amplitude_label,
    blank,
    colours,
    common_model,
    family,
    finished,
    plain,
    style,
    title,
)
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.results.quantities import extremes
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch
    from casadi_skin.points.edge_curve import EdgeCurve

DASHED, DOTTED = (0, (4.0, 1.4)), (0, (1.0, 1.2))
CURVES = {  # words and dashes of a curve of special points, by kind and whether they are orbits
    ("fold", False): ("folds", "-"),
    ("hopf", False): ("Hopf points", DASHED),
    ("branch point", False): ("branch points", DOTTED),
    ("period doubling", False): ("period doublings", DASHED),
    ("torus", False): ("tori", DOTTED),
    ("fold", True): ("folds of cycles", "-"),
    ("period doubling", True): ("period doublings", DASHED),
    ("torus", True): ("tori", DOTTED),
    ("branch point", True): ("branch points of cycles", DOTTED),
}
WIDTHS = {False: 1.5, True: 2.8}  # of lines of equilibria, and of cycles


def bifurcation_figure(branches: Sequence[Branch], title: str = "", state: int = 0) -> Figure:
    """A state of equilibria, and its largest and smallest value along cycles, against the parameter.

    Arguments:
        branches: branches of equilibria and orbits in one parameter.
        title: stands in place of the name of the model.
        state: place of the state among its names, from 0.

    Returns:
        The figure: stable stretches solid, unstable ones dashed, cycles in broader lines of another colour, and a
        symbol for each kind of special point. Lines are smooth curves through the points computed.

    Raises:
        ValueError: there is no solution, or a branch is followed in another parameter.
    """
    held = [branch for branch in branches if len(branch)]
    if not held or any(branch.parameter != held[0].parameter for branch in held):
        raise ValueError("branches: given none, or several parameters; accepted: branches in one parameter")
    first = held[0].solutions[0]
    name = plain(first.space.state_names[state])
    rest, cycle = colours(2)
    with style():
        figure = blank(6.4, 4.2)
        axes = figure.subplots()
        for branch in held:
            orbits = isinstance(branch.solutions[0], Orbit)
            for heights in _heights(branch, state):
                path = np.column_stack([branch.values, heights])
                _draw(axes, branch, path, cycle if orbits else rest)
                _mark(axes, branch, path)
        equilibria = [isinstance(branch.solutions[0], Equilibrium) for branch in held]
        both = f"{name}, of cycles largest and smallest" if any(equilibria) else f"{name}: largest and smallest value"
        what = name if all(equilibria) else both
        axes.set(xlabel=plain(held[0].parameter), ylabel=what)
        axes.set_title(_title(held[0], title, (held[0].parameter,)), y=1.0)
        return finished(figure, [axes], 3, plain=True)


def curves_figure(curves: Sequence[Branch], title: str = "") -> Figure:
    """Curves of special points in the plane of two parameters, with their points of codimension two.

    Arguments:
        curves: results of `point.curve`, all in the same two parameters.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: a branch is no curve in these two parameters.
    """
    planes = {(curve.parameter, *curve.space.free[:1]) for curve in curves if curve.space.kind}
    if len(planes) != 1 or len(next(iter(planes))) != 2:
        raise ValueError("curves: given branches of other kinds or in other parameters; accepted: curves in one plane")
    second, first = next(iter(planes))
    with style():
        figure = blank(6.0, 4.4)
        axes = figure.subplots()
        looks = [(curve.space.kind, isinstance(curve.solutions[0], Orbit)) for curve in curves]
        order = [look for look in CURVES if look in looks]
        for curve, look in zip(curves, looks, strict=True):
            words, dashes = CURVES[look]
            path = np.column_stack([curve[first], curve[second]])
            colour = colours(max(2, len(order)))[order.index(look) if len(order) > 1 else int(look[0] == "hopf")]
            axes.plot(*smooth(path).T, ls=dashes, lw=1.8, color=colour, label=words)
            _mark(axes, curve, path)
        axes.set(xlabel=plain(first), ylabel=plain(second))
        axes.set_title(_title(curves[0], title, (first, second)), y=1.0)
        return finished(figure, [axes], 4, plain=True)


def edges_figure(curves: Sequence[EdgeCurve], title: str = "") -> Figure:
    """Edges of tongues of families in the plane of a parameter and S, with their error bars where these show.

    Arguments:
        curves: results of `Branch.edge(number).curve`, all in the same parameter.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: curves are in different parameters.
    """
    if len({curve.parameter for curve in curves}) != 1:
        raise ValueError("curves: given edges in different parameters, or none; accepted: edges in one parameter")
    model, name = curves[0].points[0].orbit.model, curves[0].parameter
    words = {"real": "through 1 or -1", "complex": "Krein collisions"}
    with style():
        figure = blank(6.0, 4.4)
        axes = figure.subplots()
        kinds = [*words, *sorted({curve.kind for curve in curves} - set(words))]
        for kind, colour in zip(kinds, colours(len(kinds)), strict=True):
            alike = [curve for curve in curves if curve.kind == kind]
            for k, curve in enumerate(alike):
                path = np.column_stack([curve[name], curve.S])
                axes.plot(*smooth(path).T, lw=1.4, color=colour, label=words.get(kind, kind) if k == 0 else None)
        axes.set(xlabel=plain(name), ylabel=amplitude_label(model))
        axes.set_title(title or f"edges of tongues of {getattr(model, 'name', 'the chain')}", y=1.0)
        return finished(figure, [axes], 4, plain=True)


def _has_orbits(branch: Branch) -> bool:
    return isinstance(branch.solutions[0], Orbit)


def _heights(branch: Branch, state: int) -> list[Array]:
    """A state along a branch: its value at equilibria, its largest and smallest along orbits."""
    if isinstance(branch.solutions[0], Equilibrium):
        return [np.array([solution.evaluate(0.0)[state] for solution in branch.solutions])]
    low, high = np.array([[side[state] for side in extremes(solution)] for solution in branch.solutions]).T
    return [high, low]


def _draw(axes: Axes, branch: Branch, path: Array, colour: object) -> None:
    first = branch.solutions[0]
    kind = "equilibria" if isinstance(first, Equilibrium) else "cycles" if _has_orbits(branch) else "solutions"
    for stable, piece in stability_pieces(branch, path):
        look = {**LOOKS[stable], "lw": WIDTHS[_has_orbits(branch)]}
        known = look.pop("label")
        words = label_of(kind if kind == "solutions" and stable is None else f"{kind}, {known}", piece, path)
        axes.plot(*smooth(piece).T, color=colour, zorder=3, label=words, **look)


def _mark(axes: Axes, branch: Branch, path: Array) -> None:
    """A symbol for each special point."""
    for kind in dict.fromkeys(solution.point.special for solution in branch.solutions):
        if not kind:
            continue
        marker, face = MARKS.get(kind, PLAIN)
        places = [i for i, solution in enumerate(branch.solutions) if solution.point.special == kind]
        axes.plot(*path[places].T, marker, color="black", ms=6, mfc=face, mec="black", ls="none", label=kind, zorder=5)


def _title(branch: Branch, title: str, without: tuple[str, ...]) -> str:
    solution = branch.solutions[0]
    names = (*without, *branch.space.free)
    known = {key: value for key, value in solution.parameters.items() if key not in names}
    return model_title(solution.space.model, known, title)


# Frequency against amplitude of families: stability, the linear band, the theory's line (paper, Fig. 3a, d and 7) -----

FLAT = 0.02  # of the height of a picture: a change of frequency that it does not show
APART = 30.0  # ratio of shifts that one linear scale does not show
NEAR, SHORT = 1e-2, 0.1  # of the largest S, and of that of the shortest family: where logarithmic scales begin
LABELS = 24  # as many as fit one above the other beside the frequencies


def family_path(branch: Branch, shift: bool) -> Array:
    """S and Omega (or Omega - omega_j) from the linear mode on in arclength order, shape (points + 1, 2)."""
    values = [orbit.Omega_shift if shift else orbit.Omega for orbit in branch.orbits]
    return np.column_stack([np.append(0.0, branch.S), np.append(0.0 if shift else branch.start.Omega, values)])


def family_pieces(branch: Branch, path: Array, shift: bool = False) -> list[tuple[bool | None, Array]]:
    """The path of a family, as `family_path` makes it, in stretches of one stability each, exact where it is known."""
    diagram = branch.stability_diagram
    if diagram is None or not diagram.pieces:
        return stability_pieces(branch, path)
    return frequency_pieces(branch, diagram, shift)


def _draw_theory(axes: Axes, branch: Branch, S: Array, shift: bool) -> None:
    """The frequency to first order in S, where there is a formula; of a shift its slope alone."""
    coordinates = family(branch).coordinates
    theory = coordinates.first_order_frequency(S)
    if theory is None:
        return
    if shift:
        ends = coordinates.first_order_frequency(np.array([0.0, 1.0]))
        assert ends is not None
        theory = (ends[1] - ends[0]) * S
    axes.plot(
        S, theory, color="black", lw=0.8, ls=(0, (1.0, 3.0)), label="multiple scales, first order in $S$", zorder=4
    )


def draw_band(axes: Axes, model: Any, offset: float = 0.0, parameters: Mapping[str, float] | None = None) -> None:
    """From the lowest to the highest linear frequency of each band, a line where they are the same; less `offset`.

    Bands of a lattice are those of its cell; frequencies between them, or of cells that differ, are lines.
    """
    drawn = set[str]()
    for low, high in _bands(model, parameters):
        is_line = high - low <= 1e-12 * abs(high)
        label, width = ("linear frequency", 2.5) if is_line else ("linear band", 0.0)
        ends = np.sqrt(np.maximum((low, high), 0.0)) - offset
        axes.axhspan(*ends, fc="0.9", ec="0.75", lw=width, label=None if label in drawn else label, zorder=0)
        drawn.add(label)


def _bands(model: Any, parameters: Mapping[str, float] | None) -> Sequence[tuple[float, float]]:
    """Ends of bands in omega^2, with both the same for a frequency that lies in none."""
    if not isinstance(model, Lattice):
        spectrum = linear_spectrum(model, parameters)
        return spectrum.bands or (spectrum.ends,)
    own = lattice_modes(model, parameters).squares.real
    known = [] if model.declaration.differing else band_edges(model, parameters)
    slack = 1e-9 * float(np.max(np.abs(own)))
    apart = [square for square in own.tolist() if not any(a - slack <= square <= b + slack for a, b in known)]
    return [*known, *((square, square) for square in apart)]


def label_ends(axes: Axes, branches: Sequence[Branch], ends: Array) -> None:
    """Write each family's mode where its line ends; of those at the right outside the frame, apart from each other."""
    (low, high), right = axes.get_ylim(), axes.get_xlim()[1]
    heights = (ends[:, 1] - low) / (high - low)
    outside = [int(i) for i in np.argsort(heights, kind="stable") if ends[i, 0] > 0.97 * right]
    inside = set(range(len(branches))) - set(outside)
    outside = outside[:: -(-len(outside) // LABELS) or 1]
    gap, places = 0.048 if len(outside) < 22 else 1.0 / LABELS, heights[outside]
    for i in range(1, len(places)):
        places[i] = max(places[i], places[i - 1] + gap)
    for i in range(len(places))[::-1]:
        places[i] = min(places[i], 1.0 - gap * (len(places) - 1 - i))
    leader = {"arrowstyle": "-", "lw": 0.5, "color": "0.45", "shrinkA": 0, "shrinkB": 0}
    common: dict[str, Any] = {"va": "center", "xycoords": "data", "annotation_clip": False}
    names = [f"$j = {family(branch).coordinates.mode_number}$" for branch in branches]
    for i, place in zip(outside, places, strict=True):
        at = (1.045, float(place))
        axes.annotate(names[i], tuple(ends[i]), at, textcoords="axes fraction", arrowprops=leader, **common)
    for i in inside:
        axes.annotate(names[i], tuple(ends[i]), (6, 0), textcoords="offset points", zorder=8, **common)


def _hardly_move(paths: Sequence[Array]) -> bool:
    """Whether one of several families changes its frequency by less than a picture of all of them shows."""
    moved = [float(np.ptp(path[:, 1])) for path in paths]
    return len(paths) > 1 and min(moved) < FLAT * float(np.ptp(np.concatenate(paths)[:, 1]))


def _draw_shifts(axes: Axes, branches: Sequence[Branch]) -> None:
    """Omega - omega_j of families against S; their sizes on logarithmic scales where these differ too much."""
    paths = [family_path(branch, True) for branch in branches]
    ends = np.array([path[-1] for path in paths])
    sizes = np.abs(ends[:, 1])
    apart = bool(sizes.max() > APART * sizes.min() > 0.0)
    for branch, path, colour in zip(branches, paths, colours(len(branches)), strict=True):
        pieces = family_pieces(branch, path, True)
        shown = [(stable, np.abs(piece) if apart else piece) for stable, piece in pieces]
        draw_lines(axes, branch, np.abs(path) if apart else path, shown, colour)
        draw_marks(axes, branch, np.abs(path) if apart else path, colour)
    right = float(ends[:, 0].max())
    axes.set(xlabel=amplitude_label(branches[0].space.model), xlim=(0.0, right))
    if not apart:
        axes.set_ylabel(r"frequency shift $\Omega - \omega_j$")
        label_ends(axes, branches, ends)
        return
    left = min(NEAR * right, SHORT * float(ends[:, 0].min()))
    limits = 0.1 * float(np.min(sizes * left / ends[:, 0])), 2.0 * float(sizes.max())
    label = r"frequency shift $|\Omega - \omega_j|$"
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=limits, ylabel=label)
    for branch, end, size in zip(branches, ends, sizes, strict=True):
        name = f"$j = {family(branch).coordinates.mode_number}$"
        axes.annotate(name, (end[0], size), (6, 0), textcoords="offset points", va="center", annotation_clip=False)


def frequency_figure(branches: Sequence[Branch]) -> Figure:
    """Omega against S of families, stable solid and unstable dashed (paper, Fig. 3a and d).

    Of one family whose frequency hardly moves, Omega - omega_j is shown; where one of several hardly moves,
    all these shifts stand beside the frequencies.

    Arguments:
        branches: one or more families of one model at the same values of its parameters.

    Returns:
        The figure.

    Raises:
        ValueError: there is no branch, one is no family, or they are of different models.
    """
    model, parameters = common_model(branches)
    with style():
        paths = [family_path(branch, False) for branch in branches]
        beside = _hardly_move(paths)
        figure = blank(11.0 if beside else 6.0, 4.6)
        axes = figure.add_subplot(1, 1 + beside, 1)
        shift = len(branches) == 1 and bool(np.ptp(paths[0][:, 1]) < 1e-4 * paths[0][0, 1])
        if shift:
            paths = [family_path(branches[0], True)]
        draw_band(axes, model, branches[0].start.Omega if shift else 0.0, parameters)
        for branch, path, colour in zip(branches, paths, colours(len(branches)), strict=True):
            draw_lines(axes, branch, path, family_pieces(branch, path, shift), colour, strip=len(branches) == 1)
            if branch.unresolved:
                shade_unresolved(axes, branch.unresolved)
            _draw_theory(axes, branch, np.array([0.0, path[:, 0].max()]), shift)
            draw_marks(axes, branch, path, colour)
        points = np.concatenate(paths)
        low, high = points[:, 1].min(), points[:, 1].max()
        margin = 0.07 * (high - low) or 0.05 * (high or 1.0)
        axes.set(xlim=(0.0, points[:, 0].max() or 1.0), ylim=(low - margin, high + margin))
        axes.set_title(title(model, parameters), y=1.0)
        label_ends(axes, branches, np.array([path[-1] for path in paths]))
        if beside:
            _draw_shifts(figure.add_subplot(1, 2, 2), branches)
        mode = family(branches[0]).coordinates.mode_number
        label = rf"frequency shift $\Omega - \omega_{{{mode}}}$" if shift else r"frequency $\Omega$"
        axes.set(xlabel=amplitude_label(model), ylabel=label)
        return finished(figure, [axes], 3, in_black=True, plain=True)
