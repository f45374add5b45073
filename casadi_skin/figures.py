"""Pictures of results: frequencies, profiles and multipliers of families, and the linear spectrum; dimensionless.

Figures are made without pyplot and without touching the caller's matplotlib settings; `save` writes PNG and SVG whose
bytes depend on the data alone. Families are told apart by labels, markers and dashes, never by colour alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

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

MARKERS = "os^Dv<"
MARKED_SITES = 60  # of longer chains profiles are lines without markers
LABELS = 24  # as many labels as fit one above the other beside the frequencies
FRAME = 3.0  # multipliers farther from 0 than this are told in words
DASHES = (3.0, 1.6)
GREY, BAND = "0.45", "0.9"


def _style() -> AbstractContextManager[None]:
    """The settings in which figures are made and saved."""
    import matplotlib

    return matplotlib.rc_context(
        {
            "font.family": "STIXGeneral",
            "font.size": 10.0,
            "mathtext.fontset": "stix",
            "axes.titlesize": 10.0,
            "axes.linewidth": 0.7,
            "axes.formatter.use_mathtext": True,
            "axes.formatter.limits": (-3, 4),
            "xtick.direction": "in",
            "ytick.direction": "in",
            "xtick.top": True,
            "ytick.right": True,
            "legend.fontsize": 9.0,
            "legend.frameon": False,
            "svg.hashsalt": "casadi_skin",
        }
    )


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _finished(figure: Figure) -> Figure:
    """The figure laid out once, so that ticks, which are made when first drawn, have the style too."""
    figure.draw_without_rendering()
    return figure


def _legend(figure: Figure, panels: Iterable[Axes], columns: int, in_black: bool = False) -> None:
    """One legend below the panels, each label once; in black where colours tell families apart."""
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    legend = figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)
    for line in legend.get_lines() if in_black else ():
        line.set(color="black", markeredgecolor="black")


def _title(chain: Chain) -> str:
    return rf"$N = {chain.sites}$, $\alpha = {chain.alpha:g}$, $\gamma = {chain.gamma:g}$, $g = {chain.g:g}$"


def _colours(count: int) -> Array:
    """Colours from dark to light, so that their order survives in grey, shape (count, 4)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(0.0, 0.8, count)))


def _common_chain(branches: Sequence[Branch], name: str) -> Chain:
    chains = {branch.tools.request.chain for branch in branches}
    if len(chains) != 1:
        raise ValueError(f"{name}: given branches of {len(chains)} chains; accepted: branches of one chain")
    return chains.pop()


def _requested(branch: Branch, at_most: int) -> list[Orbit]:
    """Requested orbits, evenly picked with the first and the last where there are more than `at_most`."""
    orbits = [orbit for orbit in branch.orbits if orbit.point.requested]
    picked = np.linspace(0, len(orbits) - 1, min(at_most, len(orbits))).round().astype(int)
    return [orbits[i] for i in picked]


# Frequencies --------------------------------------------------------------------------------------------------------


def _path(branch: Branch, shift: bool) -> Array:
    """S and Omega (or Omega - omega_j) from the linear mode on in arclength order, shape (points + 1, 2)."""
    values = [orbit.Omega_shift if shift else orbit.Omega for orbit in branch.orbits]
    start = 0.0 if shift else branch.start.Omega
    return np.column_stack([np.append(0.0, branch.S), np.append(start, values)])


def _pieces(branch: Branch, path: Array, shift: bool) -> list[tuple[bool | None, Array]]:
    """Stretches of the path with one stability each (None: not computed), neighbours sharing the change between them.

    Changes that were not located are placed midway between the two points.
    """
    if not branch.with_stability or not branch.orbits:
        return [(None, path)]
    stable = np.append(branch.stable[0], branch.stable)  # the linear mode counts with the first orbit
    flips = np.flatnonzero(stable[1:] != stable[:-1])
    pieces: list[tuple[bool | None, Array]] = []
    rest, first = path[:0], 0
    for index, flip in enumerate(flips):
        joint = 0.5 * (path[flip] + path[flip + 1])
        if len(branch.changes) >= flips.size:
            change = branch.changes[index]
            part = (change.S - path[flip, 0]) / ((path[flip + 1, 0] - path[flip, 0]) or 1.0)
            between = path[flip, 1] + part * (path[flip + 1, 1] - path[flip, 1])
            joint = np.array([change.S, between if shift else change.Omega])
        pieces.append((bool(stable[flip]), np.vstack([rest, path[first : flip + 1], joint])))
        rest, first = joint[None], flip + 1
    return [*pieces, (bool(stable[-1]), np.vstack([rest, path[first:]]))]


def _draw_family(axes: Axes, branch: Branch, path: Array, shift: bool, colour: Array) -> None:
    looks = {True: ("stable", 2.0, "-"), False: ("unstable", 2.0, (0, DASHES)), None: ("stability not computed", 0.9, "-")}
    pieces = _pieces(branch, path, shift)
    for stable, piece in pieces:
        label, width, dashes = looks[stable]
        axes.plot(*piece.T, color=colour, lw=width, ls=dashes, label=label, zorder=3)
    joints = np.array([piece[-1] for _, piece in pieces[:-1]]).reshape(-1, 2)
    axes.plot(*joints.T, "|", ms=7, mew=0.9, color="black", label="change of stability" if len(joints) else None, zorder=5)
    request = branch.tools.request
    chain, S = request.chain, np.linspace(0.0, path[:, 0].max(), 2)
    slope = multiple_scales.frequency_slope(chain.sites, chain.alpha, chain.gamma, chain.g, request.mode)
    if shift:
        theory = slope * S
    else:
        theory = multiple_scales.frequency(chain.sites, chain.alpha, chain.gamma, chain.g, request.mode, S)
    axes.plot(S, theory, color="black", lw=0.8, ls=(0, (1.0, 3.0)), label="multiple scales, first order in $S$", zorder=4)
    marked = [i + 1 for i, orbit in enumerate(branch.orbits) if orbit.point.requested]
    label = "requested" if marked else None
    axes.plot(*path[marked].T, "o", ms=4, mfc="white", mec=colour, label=label, zorder=6, clip_on=False)
    if branch.end is not End.REACHED:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)


def _draw_band(axes: Axes, chain: Chain, offset: float) -> None:
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, np.array([1, chain.sites]))
    low, high = np.sqrt(np.maximum(squares, 0.0)) - offset
    if squares[1] - squares[0] > 1e-12 * abs(squares[1]):
        axes.axhspan(low, high, color=BAND, lw=0, label="linear band", zorder=0)
    else:
        axes.axhline(high, color="0.7", lw=2.5, label="linear frequency", zorder=0)


def _label_ends(axes: Axes, branches: Sequence[Branch], ends: Array) -> None:
    """Write each family's mode where its line ends: outside the frame, apart from each other, if that is at the right."""
    low, high = axes.get_ylim()
    right = axes.get_xlim()[1]
    heights = (ends[:, 1] - low) / (high - low)
    outside = [int(i) for i in np.argsort(heights, kind="stable") if ends[i, 0] > 0.97 * right]
    outside = outside[:: -(-len(outside) // LABELS) or 1]
    gap = min(0.048, 1.0 / max(1, len(outside) - 1))
    places = heights[outside]
    for _ in range(200):  # push neighbours apart from below, then back from above, until none is too near
        for i in range(1, len(places)):
            lack = gap - (places[i] - places[i - 1])
            if lack > 1e-9:
                places[i - 1] -= 0.5 * lack
                places[i] += 0.5 * lack
        places = np.clip(places, 0.0, 1.0)
    leader = {"arrowstyle": "-", "lw": 0.5, "color": GREY, "shrinkA": 0, "shrinkB": 0}
    for i, place in zip(outside, places, strict=True):
        axes.annotate(
            f"$j = {branches[i].tools.request.mode}$", tuple(ends[i]), (1.045, place), "data", "axes fraction",
            va="center", annotation_clip=False, arrowprops=leader,
        )  # fmt: skip
    for i in set(range(len(branches))) - set(outside):
        if ends[i, 0] <= 0.97 * right:
            axes.annotate(f"$j = {branches[i].tools.request.mode}$", tuple(ends[i]), (6, 0), "data", "offset points", va="center")


def frequency_figure(branches: Sequence[Branch]) -> Figure:
    """Omega against S of families of one chain, stable solid and unstable dashed (paper, Fig. 3a and d).

    Of one family whose frequency hardly moves, Omega - omega_j is shown. Raises ValueError for no branch, or branches
    of different chains.
    """
    chain = _common_chain(branches, "frequency_figure")
    with _style():
        figure = _figure(6.0, 4.6)
        axes = figure.add_subplot()
        paths = [_path(branch, False) for branch in branches]
        shift = len(branches) == 1 and np.ptp(paths[0][:, 1]) < 1e-4 * paths[0][0, 1]
        if shift:
            paths = [_path(branches[0], True)]
        _draw_band(axes, chain, branches[0].start.Omega if shift else 0.0)
        for branch, path, colour in zip(branches, paths, _colours(len(branches)), strict=True):
            _draw_family(axes, branch, path, bool(shift), colour)
        points = np.concatenate(paths)
        low, high = points[:, 1].min(), points[:, 1].max()
        margin = 0.07 * (high - low) or 0.05 * (abs(high) or 1.0)
        axes.set_ylim(low - margin, high + margin)
        axes.set_xlim(0.0, points[:, 0].max() or 1.0)
        _label_ends(axes, branches, np.array([path[-1] for path in paths]))
        axes.set_xlabel(r"total amplitude $S = \Vert y\Vert^2$")
        mode = branches[0].tools.request.mode
        axes.set_ylabel(rf"frequency shift $\Omega - \omega_{{{mode}}}$" if shift else r"frequency $\Omega$")
        axes.set_title(_title(chain) + " (dimensionless)")
        _legend(figure, [axes], 3, in_black=True)
        return _finished(figure)


# Profiles -----------------------------------------------------------------------------------------------------------


def _linear_mode(chain: Chain, mode: int) -> Array:
    """The linear mode with norm 1, largest displacement positive, shape (sites,)."""
    u = chain.right_eigenvector(mode)
    u = u / np.max(np.abs(u))  # before the norm, whose squares could underflow
    return np.asarray(u / np.linalg.norm(u) * np.sign(u[np.argmax(np.abs(u))]))


def _decades(profile: Array) -> float:
    """Decades between the largest and the smallest displacement that is not zero."""
    size = np.abs(profile[profile != 0])
    return float(np.log10(size.max() / size.min())) if size.size else 0.0


def _draw_profiles(panels: Sequence[Axes], branch: Branch, orbits: Sequence[Orbit], amplitudes: Array) -> None:
    """Profiles over the linear mode: as they are in the first panel, absolute values in the second, if there is one."""
    request, colours = branch.tools.request, _colours(len(amplitudes))
    mode = _linear_mode(request.chain, request.mode)
    n = np.arange(1, mode.size + 1)
    marked = mode.size <= MARKED_SITES
    for axes, shown in zip(panels, (lambda y: y, lambda y: np.where(y == 0, np.nan, np.abs(y))), strict=False):
        axes.plot(n, shown(mode), color="0.6", lw=3.0, label="linear mode", zorder=1)
        for orbit in orbits:
            y = orbit.profile / np.sqrt(orbit.S)
            k = int(np.searchsorted(amplitudes, orbit.S))
            look = {"marker": MARKERS[k % len(MARKERS)], "ms": 3.5, "mfc": "white"} if marked else {}
            line = axes.plot(n, shown(y * (np.sign(y @ mode) or 1.0)), color=colours[k], lw=0.9, **look)[0]
            line.set_label(f"$S = {orbit.S:g}$")
        axes.set_xlim(0.5, mode.size + 0.5)
        axes.xaxis.get_major_locator().set_params(integer=True)
    panels[0].axhline(0.0, color=GREY, lw=0.5, zorder=0)
    panels[0].set_title(f"$j = {request.mode}$", loc="left")
    panels[0].set_ylabel(r"$y_n(0)\,/\,\Vert y\Vert$")
    for axes in panels[1:]:
        axes.set_yscale("log")
        axes.set_ylabel(r"$|y_n(0)|\,/\,\Vert y\Vert$")


def profile_figure(branches: Sequence[Branch]) -> Figure | None:
    """Profiles y_n(0) of the requested orbits scaled to norm 1 over the linear mode; None where nothing was requested.

    A row a family, at most six orbits each, signed to overlap with the linear mode; absolute values beside them on a
    logarithmic scale where a profile spans more than 3 decades. Raises ValueError for no branch, or different chains.
    """
    chain = _common_chain(branches, "profile_figure")
    chosen = [(branch, _requested(branch, len(MARKERS))) for branch in branches]
    chosen = [(branch, orbits) for branch, orbits in chosen if orbits]
    if not chosen:
        return None
    amplitudes = np.unique([orbit.S for _, orbits in chosen for orbit in orbits])
    columns = 2 if any(_decades(orbit.profile) > 3.0 for _, orbits in chosen for orbit in orbits) else 1
    with _style():
        rows = len(chosen)
        figure = _figure(3.7 * columns, 0.9 + (2.6 if rows == 1 else 1.5 * rows))
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for row, (branch, orbits) in zip(panels, chosen, strict=True):
            _draw_profiles(row, branch, orbits, amplitudes)
        for axes in panels[-1]:
            axes.set_xlabel("site $n$")
        figure.suptitle(_title(chain) + " (dimensionless)", fontsize=10.0)
        figure.align_ylabels()
        _legend(figure, panels[:, 0], 3 * columns)
        return _finished(figure)


# Multipliers --------------------------------------------------------------------------------------------------------


def _draw_moduli(axes: Axes, branch: Branch) -> None:
    """|lambda| of all multipliers off the circle, the largest as a line, against S."""
    S, largest, path_S, path_largest = branch.S, branch.max_abs_multiplier, [], []
    stable, changes = branch.stable, list(branch.changes)
    for i, orbit in enumerate(branch.orbits):
        if i and stable[i] != stable[i - 1] and changes:  # multipliers leave the circle at the change itself
            path_S.append(changes.pop(0).S)
            path_largest.append(1.0)
        path_S.append(S[i])
        path_largest.append(largest[i])
        floquet = orbit.floquet()
        outer = np.abs(floquet.root[~floquet.is_inside]) ** (2 * floquet.power)
        moduli = np.concatenate([outer, 1.0 / outer])
        axes.plot(np.full(moduli.size, S[i]), moduli, ".", ms=3.0, color="0.25", zorder=3)
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    axes.plot(path_S, path_largest, color=_colours(3)[1], lw=1.3, label=r"largest $\left|\lambda\right|$", zorder=2)
    for change in branch.changes:
        look = "-" if change.kind == "real" else (0, DASHES)
        axes.axvline(change.S, color="0.4", lw=0.6, ls=look, label=f"change of stability ({change.kind})", zorder=0)
    if largest.max() > 10.0:
        axes.set_yscale("log")
    elif largest.max() == 1.0:
        axes.set_ylim(0.9, 1.1)
    axes.set_xlim(0.0, 1.03 * S.max())
    axes.set_box_aspect(1)
    axes.set_xlabel(r"total amplitude $S = \Vert y\Vert^2$")
    axes.set_ylabel(r"$\left|\lambda\right|$ (trivial pair left out)")


def _draw_plane(axes: Axes, orbit: Orbit) -> None:
    """Multipliers of one orbit in the complex plane, marked by kind."""
    from matplotlib.ticker import MaxNLocator

    floquet = orbit.floquet()
    others = floquet.multipliers[2:]
    inside, real = (np.repeat(flags, 2) for flags in (floquet.is_inside, floquet.is_real))
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.7", lw=1.0, zorder=1)
    kinds = (
        ("on the unit circle", inside, {"marker": "o", "ms": 4.0, "mfc": "white", "mec": "black", "mew": 0.8}),
        ("real, off the circle", ~inside & real, {"marker": "s", "ms": 5.0, "mfc": "black", "mec": "black"}),
        ("complex, off the circle", ~real, {"marker": "^", "ms": 5.5, "mfc": "0.6", "mec": "black", "mew": 0.8}),
    )
    near = np.abs(others) <= FRAME
    for label, chosen, look in kinds:
        shown = others[chosen & near]
        axes.plot(shown.real, shown.imag, ls="", label=label, zorder=3, **look)
    axes.plot([1.0], [0.0], "+", ms=8, color="black", label="trivial pair", zorder=4)
    reach = 1.12 * float(np.max(np.abs(others[near]), initial=1.15))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.set(xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$")
    lines = [f"$S = {orbit.S:g}$", rf"max $\left|\lambda\right| = {floquet.max_abs_multiplier:.4g}$"]
    if not near.all():
        lines.append(f"{np.count_nonzero(~near)} out of the frame")
    axes.text(0.0, 0.0, "\n".join(lines), ha="center", va="center")


def multiplier_figure(branch: Branch) -> Figure | None:
    """Moduli of the multipliers against S, and multipliers in the complex plane at up to three requested orbits.

    The last orbit stands in where none was requested. None where stability was not computed (paper, Fig. 5a to c).
    """
    if not branch.with_stability or not branch.orbits:
        return None
    orbits = _requested(branch, 3) or [branch.orbits[-1]]
    request = branch.tools.request
    with _style():
        figure = _figure(*{1: (6.8, 3.8), 2: (9.6, 3.8), 3: (6.8, 7.0)}[len(orbits)])
        layout = {1: "ab", 2: "abc", 3: "ab;cd"}[len(orbits)]
        panels = figure.subplot_mosaic(layout)
        _draw_moduli(panels["a"], branch)
        panels["a"].set_title("(a)", loc="left")
        for letter, orbit in zip("bcd", orbits, strict=False):
            _draw_plane(panels[letter], orbit)
            panels[letter].set_title(f"({letter})", loc="left")
            panels["a"].plot(orbit.S, orbit.floquet().max_abs_multiplier, "o", ms=5, mfc="white", mec="black", zorder=5)
            panels["a"].annotate(
                letter, (orbit.S, orbit.floquet().max_abs_multiplier), (-4, 5), "data", "offset points", ha="right"
            )
        figure.suptitle(f"family $j = {request.mode}$; " + _title(request.chain), fontsize=10.0)
        _legend(figure, panels.values(), 3)
        return _finished(figure)


# The linear chain ---------------------------------------------------------------------------------------------------


def spectrum_figure(chain: Chain) -> Figure:
    """Linear frequencies omega_j against j with the cutoffs of the infinite chain, and the modes 1 and N (paper, Fig. 2a).

    Modes that do not oscillate (omega_j^2 <= 0) are left out.
    """
    j = np.arange(1, chain.sites + 1)
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, j)
    with _style():
        figure = _figure(6.8, 3.6)
        panels = figure.subplot_mosaic("aab;aac" if chain.sites > 1 else "aab")
        axes, oscillates = panels["a"], squares > 0
        marker = "o" if chain.sites <= MARKED_SITES else ""
        axes.plot(j[oscillates], np.sqrt(squares[oscillates]), marker=marker, ms=4, lw=0.8, color="black", mfc="white")
        for square, name, x, side in zip(chain.band(), ("min", "max"), (0.97, 0.03), ("bottom", "top"), strict=True):
            if square > 0:
                axes.axhline(np.sqrt(square), color=GREY, lw=0.9, ls=(0, DASHES))
                axes.annotate(
                    rf"$\omega_\mathrm{{{name}}} = {np.sqrt(square):.4g}$", (x, np.sqrt(square)),
                    (0, 3 if side == "bottom" else -3), axes.get_yaxis_transform(), "offset points",
                    ha="right" if name == "min" else "left", va=side,
                )  # fmt: skip
        axes.set(xlabel="mode $j$", ylabel=r"linear frequency $\omega_j$")
        for letter, mode in zip("bc", (chain.sites, 1), strict=False):
            if letter in panels:
                panels[letter].axhline(0.0, color=GREY, lw=0.5)
                panels[letter].plot(j, _linear_mode(chain, mode), marker=marker, ms=2.5, lw=0.8, color="black")
                panels[letter].set_ylabel(rf"$u_{{{mode},n}}$")
                panels[letter].set_xlabel("site $n$" if mode == 1 else "")
        figure.suptitle(_title(chain) + " (dimensionless)", fontsize=10.0)
        return _finished(figure)


# Files --------------------------------------------------------------------------------------------------------------


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.svg, each replaced atomically, and return their paths; the same figure, the same bytes.

    Raises OSError where the folder does not exist or cannot be written to.
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
