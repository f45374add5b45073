"""Pictures of results: frequencies, profiles and multipliers of families, and the linear spectrum; dimensionless.

Figures are made without pyplot and leave the caller's matplotlib settings alone; what `save` writes depends on the
data alone. Families and orbits are told apart by labels, markers and dashes, never by colour alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.arclength import End
from casadi_skin.models.chain import Chain
from casadi_skin.theory import linear, multiple_scales

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.families.branch import Branch
    from casadi_skin.families.orbit import Orbit

MARKERS, LINES = "os^Dv<", ("-", "--", "-.", ":")
MARKED_SITES = 60  # profiles of longer chains are lines without markers, of the sites that move
LABELS = 24  # as many as fit one above the other beside the frequencies
FRAME = 3.0  # multipliers farther from 0 than this are told in words
AMPLITUDE = r"total amplitude $S = \Vert y\Vert^2$"
MODULUS = r"$\left|\lambda\right|$"


def _style() -> AbstractContextManager[None]:
    """The settings in which figures are made and saved."""
    import matplotlib

    return matplotlib.rc_context({
        "font.family": "STIXGeneral", "mathtext.fontset": "stix", "font.size": 10.0, "axes.titlesize": 10.0,
        "figure.titlesize": 10.0, "legend.fontsize": 9.0, "legend.frameon": False, "axes.linewidth": 0.7,
        "axes.formatter.use_mathtext": True, "axes.formatter.limits": (-3, 4), "svg.hashsalt": "casadi_skin",
        "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True, "ytick.right": True,
    })  # fmt: skip


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _finished(figure: Figure, panels: Iterable[Axes], columns: int, in_black: bool = False) -> Figure:
    """The figure with one legend of all panels below them, laid out; in black where colours tell families apart."""
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        legend = figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)
        for line in legend.get_lines() if in_black else ():
            line.set(color="black", markeredgecolor="black")
    engine = figure.get_layout_engine()
    if engine is not None:  # once and for all: laying out is slow, and makes the ticks while the style is set
        engine.execute(figure)
    figure.set_layout_engine("none")
    return figure


def _number(value: float, digits: int = 6) -> str:
    """The number as it stands in a formula."""
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return rf"{mantissa}\times 10^{{{int(exponent)}}}" if exponent else mantissa


def _title(chain: Chain) -> str:
    values = (("N", chain.sites), (r"\alpha", chain.alpha), (r"\gamma", chain.gamma), ("g", chain.g))
    return ", ".join(f"${name} = {_number(value)}$" for name, value in values) + " (dimensionless)"


def _colours(count: int) -> Array:
    """Colours from dark to light, so that their order survives in grey, shape (count, 4)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(0.0, 0.8, count)))


def _common_chain(branches: Sequence[Branch]) -> Chain:
    chains = {branch.tools.request.chain for branch in branches}
    if len(chains) != 1:
        raise ValueError(f"branches: given branches of {len(chains)} chains; accepted: one or more, all of one chain")
    return chains.pop()


def _number_sites(axes: Axes, first: int, last: int, label: str) -> None:
    """Whole numbers along the axis, from `first` to `last`."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=(first - 0.5, last + 0.5), xlabel=label)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))


# Frequencies --------------------------------------------------------------------------------------------------------


def _path(branch: Branch, shift: bool) -> Array:
    """S and Omega (or Omega - omega_j) from the linear mode on in arclength order, shape (points + 1, 2)."""
    values = [orbit.Omega_shift if shift else orbit.Omega for orbit in branch.orbits]
    return np.column_stack([np.append(0.0, branch.S), np.append(0.0 if shift else branch.start.Omega, values)])


def _pieces(branch: Branch, path: Array, shift: bool) -> list[tuple[bool | None, Array]]:
    """Stretches of the path with one stability each (None: not computed), neighbours sharing the change between them.

    Changes that were not located are placed midway between the two points.
    """
    if not branch.with_stability or not branch.orbits:
        return [(None, path)]
    stable = np.append(branch.stable[0], branch.stable)  # the linear mode counts with the first orbit
    flips = np.flatnonzero(stable[1:] != stable[:-1])
    pieces: list[tuple[bool | None, Array]] = []
    rest = path[:0]
    for index, (flip, first) in enumerate(zip(flips, np.append(0, flips + 1), strict=False)):
        before, after = path[flip], path[flip + 1]
        joint = 0.5 * (before + after)
        if len(branch.changes) >= flips.size:
            change = branch.changes[index]
            part = (change.S - before[0]) / ((after[0] - before[0]) or 1.0)
            joint = np.array([change.S, before[1] + part * (after[1] - before[1]) if shift else change.Omega])
        pieces.append((bool(stable[flip]), np.vstack([rest, path[first : flip + 1], joint])))
        rest = joint[None]
    return [*pieces, (bool(stable[-1]), np.vstack([rest, path[flips[-1] + 1 if flips.size else 0 :]]))]


def _draw_family(axes: Axes, branch: Branch, path: Array, shift: bool, colour: Array) -> None:
    looks: dict[bool | None, dict[str, Any]] = {
        True: {"label": "stable", "lw": 2.0},
        False: {"label": "unstable", "lw": 2.0, "ls": (0, (3.0, 1.6))},
        None: {"label": "stability not computed", "lw": 0.9},
    }
    pieces = _pieces(branch, path, shift)
    for stable, piece in pieces:
        axes.plot(*piece.T, color=colour, zorder=3, **looks[stable])
    if len(pieces) > 1:
        joints = np.array([piece[-1] for _, piece in pieces[:-1]])
        axes.plot(*joints.T, "|", ms=7, mew=0.9, color="black", label="change of stability", zorder=5)
    core, S = branch.tools.core, np.array([0.0, path[:, 0].max()])
    parameters = (core.sites, core.alpha, core.gamma, core.g, branch.tools.core_mode)
    theory = multiple_scales.frequency_slope(*parameters) * S if shift else multiple_scales.frequency(*parameters, S)
    axes.plot(
        S, theory, color="black", lw=0.8, ls=(0, (1.0, 3.0)), label="multiple scales, first order in $S$", zorder=4
    )
    marked = [i + 1 for i, orbit in enumerate(branch.orbits) if orbit.point.requested]
    if marked:
        axes.plot(*path[marked].T, "o", ms=4, mfc="white", mec=colour, label="requested", zorder=6, clip_on=False)
    if branch.end is not End.REACHED:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)


def _draw_band(axes: Axes, chain: Chain, offset: float) -> None:
    """From omega_1 to omega_N of the finite chain, a line where they are the same; less `offset`."""
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, np.array([1, chain.sites]))
    low, high = np.sqrt(np.maximum(squares, 0.0)) - offset
    is_line = squares[1] - squares[0] <= 1e-12 * abs(squares[1])
    label, width = ("linear frequency", 2.5) if is_line else ("linear band", 0.0)
    axes.axhspan(low, high, fc="0.9", ec="0.75", lw=width, label=label, zorder=0)


def _label_ends(axes: Axes, branches: Sequence[Branch], ends: Array) -> None:
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
    for i, place in zip(outside, places, strict=True):
        text, at = f"$j = {branches[i].tools.request.mode}$", (1.045, float(place))
        axes.annotate(text, tuple(ends[i]), at, textcoords="axes fraction", arrowprops=leader, **common)
    for i in inside:
        text = f"$j = {branches[i].tools.request.mode}$"
        axes.annotate(text, tuple(ends[i]), (6, 0), textcoords="offset points", zorder=8, **common)


def frequency_figure(branches: Sequence[Branch]) -> Figure:
    """Omega against S of families of one chain, stable solid and unstable dashed (paper, Fig. 3a and d).

    Of one family whose frequency hardly moves, Omega - omega_j is shown. Raises ValueError for no branch, and for
    branches of different chains.
    """
    chain = _common_chain(branches)
    with _style():
        figure = _figure(6.0, 4.6)
        axes = figure.add_subplot()
        paths = [_path(branch, False) for branch in branches]
        shift = len(branches) == 1 and bool(np.ptp(paths[0][:, 1]) < 1e-4 * paths[0][0, 1])
        if shift:
            paths = [_path(branches[0], True)]
        _draw_band(axes, chain, branches[0].start.Omega if shift else 0.0)
        for branch, path, colour in zip(branches, paths, _colours(len(branches)), strict=True):
            _draw_family(axes, branch, path, shift, colour)
        points = np.concatenate(paths)
        low, high = points[:, 1].min(), points[:, 1].max()
        margin = 0.07 * (high - low) or 0.05 * (high or 1.0)
        axes.set(xlim=(0.0, points[:, 0].max() or 1.0), ylim=(low - margin, high + margin), title=_title(chain))
        _label_ends(axes, branches, np.array([path[-1] for path in paths]))
        mode = branches[0].tools.request.mode
        label = rf"frequency shift $\Omega - \omega_{{{mode}}}$" if shift else r"frequency $\Omega$"
        axes.set(xlabel=AMPLITUDE, ylabel=label)
        return _finished(figure, [axes], 3, in_black=True)


# Profiles -----------------------------------------------------------------------------------------------------------


def _linear_mode(chain: Chain, mode: int) -> Array:
    """The linear mode with norm 1, largest displacement positive, shape (sites,)."""
    u = chain.right_eigenvector(mode)
    return np.asarray(u / np.linalg.norm(u) * np.sign(u[np.argmax(np.abs(u))]))


def _sizes(y: Array) -> Array:
    """|y_n| with nan for zeros, and for nodes that are zero to round-off beside their neighbours, shape (sites,)."""
    size = np.pad(np.abs(y), 1)
    return np.where(size[1:-1] > 1e-13 * np.maximum(size[:-2], size[2:]), size[1:-1], np.nan)


def _moving(profiles: Array) -> tuple[int, int]:
    """First and last site where profiles, shape (some, sites), exceed 1e-3 of their largest; all of a short chain."""
    largest = np.max(np.abs(profiles), axis=1, keepdims=True)
    seen = np.flatnonzero(np.any(np.abs(profiles) > 1e-3 * largest, axis=0)) + 1
    sites = profiles.shape[1]
    return (int(seen[0]), int(seen[-1])) if sites > MARKED_SITES else (1, sites)


def _requested(branch: Branch, at_most: int) -> dict[tuple[float, int], Orbit]:
    """Requested orbits by S and the number of times that S was passed before, evenly picked where there are more."""
    orbits = [orbit for orbit in branch.orbits if orbit.point.requested]
    keys = [(orbit.S, sum(before.S == orbit.S for before in orbits[:i])) for i, orbit in enumerate(orbits)]
    picked = [round(i) for i in np.linspace(0, len(orbits) - 1, min(at_most, len(orbits)))]
    return {keys[i]: orbits[i] for i in picked}


def _looks(keys: Sequence[tuple[float, int]], marked: bool) -> dict[tuple[float, int], dict[str, Any]]:
    """How profiles at each S are drawn: markers, which shrink so that those of coinciding profiles show, or dashes."""
    looks: dict[tuple[float, int], dict[str, Any]] = {}
    for k, (key, colour) in enumerate(zip(keys, _colours(len(keys)), strict=True)):
        passage = f" (passage {key[1] + 1})" if key[1] else ""
        marker = {"marker": MARKERS[k % len(MARKERS)], "ms": 5.0 - 2.0 * k / len(keys), "mfc": "white"}
        dashes = marker if marked else {"ls": LINES[k % len(LINES)]}
        looks[key] = {"color": colour, "lw": 0.9, "label": f"$S = {_number(key[0])}${passage}", **dashes}
    return looks


def _draw_profiles(
    panels: Sequence[Axes], branch: Branch, orbits: dict[tuple[float, int], Orbit], looks: dict[Any, dict[str, Any]]
) -> None:
    """Profiles over the linear mode: as they are in the first panel, sizes in the second, if there is one."""
    mode = _linear_mode(branch.tools.request.chain, branch.tools.request.mode)
    n, dot = np.arange(1, mode.size + 1), "o" if mode.size == 1 else None
    profiles = {key: orbit.profile / np.sqrt(orbit.S) for key, orbit in orbits.items()}
    for axes, as_sizes in zip(panels, (False, True), strict=False):
        axes.plot(n, _sizes(mode) if as_sizes else mode, marker=dot, color="0.65", lw=3, ms=9, label="linear mode")
        for key, y in profiles.items():
            signed = y * (np.sign(y @ mode) or 1.0)
            axes.plot(n, _sizes(y) if as_sizes else signed, **looks[key])
    panels[0].axhline(0.0, color="0.45", lw=0.5, zorder=0)
    panels[0].set_title(f"$j = {branch.tools.request.mode}$", loc="left")
    panels[0].set_ylabel(r"$y_n(0)\,/\,\Vert y\Vert$")
    for axes in panels[1:]:
        axes.set(yscale="log", ylabel=r"$|y_n(0)|\,/\,\Vert y\Vert$")


def profile_figure(branches: Sequence[Branch]) -> Figure | None:
    """Profiles y_n(0) of requested orbits, scaled to norm 1, over the linear mode; None where nothing was requested.

    A row a family, at most six orbits each, with the sign that overlaps with the linear mode; of a long chain the sites
    that move. Where a profile spans more than 3 decades, sizes at all sites stand beside them on a logarithmic scale.
    Raises ValueError for no branch, and for branches of different chains.
    """
    chain = _common_chain(branches)
    chosen = [(branch, orbits) for branch in branches if (orbits := _requested(branch, len(MARKERS)))]
    if not chosen:
        return None
    profiles = np.array([orbit.profile for _, orbits in chosen for orbit in orbits.values()])
    sizes = np.apply_along_axis(_sizes, 1, profiles)
    steep = bool(np.any(np.nanmax(sizes, axis=1) > 1e3 * np.nanmin(sizes, axis=1)))
    keys = sorted({key for _, orbits in chosen for key in orbits})
    rows, columns = len(chosen), 2 if steep else 1
    with _style():
        looks = _looks(keys, chain.sites <= MARKED_SITES)
        figure = _figure(3.7 * columns, 0.9 + (2.6 if rows == 1 else 1.5 * rows))
        panels = figure.subplots(rows, columns, sharex="col", squeeze=False)
        for row, (branch, orbits) in zip(panels, chosen, strict=True):
            _draw_profiles(row, branch, orbits, looks)
        for axes, ends in zip(panels[-1], (_moving(profiles), (1, chain.sites)), strict=False):
            _number_sites(axes, *ends, "site $n$")
        figure.suptitle(_title(chain))
        figure.align_ylabels()
        return _finished(figure, panels[:, 0], 3 * columns)


# Multipliers --------------------------------------------------------------------------------------------------------


def _draw_moduli(axes: Axes, branch: Branch) -> None:
    """|lambda| of all multipliers off the circle, the largest as a line, against S."""
    line: list[tuple[float, float]] = []
    stable, changes = branch.stable, list(branch.changes)
    for i, orbit in enumerate(branch.orbits):
        if i and stable[i] != stable[i - 1] and changes:  # multipliers leave the circle at the change itself
            line.append((changes.pop(0).S, 1.0))
        floquet = orbit.floquet()
        line.append((orbit.S, floquet.max_abs_multiplier))
        outer = np.abs(floquet.root[~floquet.is_inside]) ** (2 * floquet.power)
        if outer.size:
            axes.plot(np.full(2 * outer.size, orbit.S), [*outer, *1.0 / outer], ".", ms=3, color="0.25", zorder=3)
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    axes.plot(*np.transpose(line), color=_colours(3)[1], lw=1.3, label=f"largest {MODULUS}", zorder=2)
    for change in branch.changes:
        dashes = "-" if change.kind == "real" else "--"
        axes.axvline(change.S, color="0.4", lw=0.6, ls=dashes, label=f"change of stability ({change.kind})", zorder=0)
    largest = branch.max_abs_multiplier.max()
    if largest > 10.0:
        axes.set_yscale("log")
    elif largest == 1.0:
        axes.set_ylim(0.9, 1.1)
    axes.set(xlim=(0.0, 1.03 * branch.S.max()), xlabel=AMPLITUDE, ylabel=f"{MODULUS} (trivial pair left out)")
    axes.set_box_aspect(1)


def _draw_plane(axes: Axes, orbit: Orbit) -> None:
    """Multipliers of one orbit in the complex plane, marked by kind."""
    from matplotlib.ticker import MaxNLocator

    floquet = orbit.floquet()
    others = floquet.multipliers[2:]
    inside, real = np.repeat(floquet.is_inside, 2), np.repeat(floquet.is_real, 2)
    near, angle = np.abs(others) <= FRAME, np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.7", lw=1.0, zorder=1)
    for label, chosen, marker, size, fill in (
        ("on the unit circle", inside, "o", 4.0, "white"),
        ("real, off the circle", ~inside & real, "s", 5.0, "black"),
        ("complex, off the circle", ~real, "^", 5.5, "0.6"),
    ):
        shown = others[chosen & near]
        if shown.size:
            axes.plot(shown.real, shown.imag, marker, ms=size, mfc=fill, mec="black", mew=0.8, label=label, zorder=3)
    axes.plot([1.0], [0.0], "+", ms=8, color="black", label="trivial pair", zorder=4)
    if not near.all():
        axes.text(0.03, 0.03, f"{np.count_nonzero(~near)} out of the frame", transform=axes.transAxes)
    reach = 1.12 * float(np.max(np.abs(others[near]), initial=1.15))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6))


def multiplier_figure(branch: Branch) -> Figure | None:
    """Moduli of the multipliers against S, and multipliers in the complex plane at up to three requested orbits.

    The last orbit stands in where none was requested. None where stability was not computed (paper, Fig. 5a to c).
    """
    if not branch.with_stability or not branch.orbits:
        return None
    orbits = list(_requested(branch, 3).values()) or [branch.orbits[-1]]
    request, layout = branch.tools.request, ("ab", "abc", "ab;cd")[len(orbits) - 1]
    with _style():
        figure = _figure(*((6.8, 3.9), (9.6, 3.9), (6.8, 7.0))[len(orbits) - 1])
        panels = figure.subplot_mosaic(layout)
        _draw_moduli(panels["a"], branch)
        panels["a"].set_title("(a)", loc="left")
        for letter, orbit in zip("bcd", orbits, strict=False):
            _draw_plane(panels[letter], orbit)
            largest = orbit.floquet().max_abs_multiplier
            words = rf"$S = {_number(orbit.S)}$, max {MODULUS} $= {_number(largest, 4)}$"
            panels[letter].set_title(f"({letter})  {words}", loc="left")
            panels["a"].plot(orbit.S, largest, "o", ms=5, mfc="white", mec="black", zorder=5, clip_on=False)
            box = {"fc": "white", "ec": "none", "pad": 0.5}
            panels["a"].annotate(
                letter, (orbit.S, largest), (-5, 6), textcoords="offset points", ha="right", bbox=box, zorder=6
            )
        figure.suptitle(f"family $j = {request.mode}$; {_title(request.chain)}")
        return _finished(figure, panels.values(), 3)


# The linear chain ---------------------------------------------------------------------------------------------------


def spectrum_figure(chain: Chain) -> Figure:
    """Linear frequencies against j, the cutoffs of the infinite chain, and the modes 1 and N (paper, Fig. 2a).

    Modes that do not oscillate (omega_j^2 <= 0) are left out. Modes have norm 1; of a long chain the sites that move.
    """
    j = np.arange(1, chain.sites + 1)
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, j)
    frequencies = np.sqrt(np.where(squares > 0, squares, np.nan))
    with _style():
        figure = _figure(6.8, 3.6)
        panels = figure.subplot_mosaic("aab;aac" if chain.sites > 1 else "aab")
        marker = "o" if chain.sites <= MARKED_SITES else ""
        panels["a"].plot(j, frequencies, marker=marker, ms=4, lw=0.8, color="black", mfc="white", zorder=3)
        for square, name, x, below in zip(chain.band(), ("min", "max"), (0.97, 0.03), (False, True), strict=True):
            if square > 0:
                omega, sides = float(np.sqrt(square)), ("left", "top") if below else ("right", "bottom")
                panels["a"].axhline(omega, color="0.45", lw=0.9, ls="--")
                panels["a"].annotate(
                    rf"$\omega_\mathrm{{{name}}} = {omega:.4g}$", (x, omega), (0, -3 if below else 3),
                    panels["a"].get_yaxis_transform(), "offset points", ha=sides[0], va=sides[1],
                )  # fmt: skip
        _number_sites(panels["a"], 1, chain.sites, "mode $j$")
        panels["a"].set_ylabel(r"linear frequency $\omega_j$")
        for letter, mode in zip("bc", (chain.sites, 1)[-len(panels) + 1 :], strict=False):
            u = _linear_mode(chain, mode)
            panels[letter].axhline(0.0, color="0.45", lw=0.5)
            panels[letter].plot(j, u, marker=marker, ms=2.5, lw=0.8, color="black")
            panels[letter].set_ylabel(rf"$u_{{{mode},n}}$")
            _number_sites(panels[letter], *_moving(u[None]), "site $n$" if mode == 1 else "")
        figure.suptitle(_title(chain))
        return _finished(figure, (), 1)


# Files --------------------------------------------------------------------------------------------------------------


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.svg, each replaced atomically, and return their paths.

    The bytes depend on the figure alone. Raises OSError where the folder does not exist or cannot be written to.
    """
    paths = []
    for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        path = stem.with_name(f"{stem.name}.{kind}")
        temporary = stem.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            with _style():
                figure.savefig(temporary, format=kind, dpi=200, metadata=metadata)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        paths.append(path)
    return paths
