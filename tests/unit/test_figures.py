"""Pictures: what they draw, where lines change their look, and files that are the same bytes every time."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from drawing import legend_labels, lines, overlaps, points, stretches
from marks import slow
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from casadi_skin import Branch, Chain, follow_family
from casadi_skin.lattice import closed_forms as multiple_scales
from casadi_skin.results.figures.bands import spectrum_figure
from casadi_skin.results.figures.families import frequency_figure, profile_figure
from casadi_skin.results.figures.multipliers import multiplier_figure
from casadi_skin.results.figures.style import blank, finished, save, style

pytestmark = pytest.mark.usefixtures("pictures")

SOFT = Chain(8, 1.0, 0.25, -1.0)


@pytest.fixture(scope="module")
def soft() -> Branch:
    """A family of the end mode with located changes of stability."""
    branch = follow_family(SOFT, 1, 3.0, at=[0.2, 1.0, 2.0, 3.0], stability=True, tolerance=1e-6)
    assert branch.changes
    return branch


@pytest.fixture(scope="module")
def plain() -> Branch:
    """A family followed without stability, with nothing requested."""
    return follow_family(SOFT, 3, 1.0, tolerance=1e-4)


def family_lines(axes: Axes) -> list[Line2D]:
    """Stretches of one stability each, those of a family in its order."""
    known = ("stable", "unstable", "stability not computed")
    drawn = [line for line in axes.get_lines() if line.get_label() in known]
    colours = list(dict.fromkeys(tuple(line.get_color()) for line in drawn))
    return sorted(stretches(drawn), key=lambda line: (colours.index(tuple(line.get_color())), points(line)[0, 0]))


# Frequencies --------------------------------------------------------------------------------------------------------


def test_stretches_alternate_and_meet_at_the_located_changes(soft: Branch) -> None:
    drawn = family_lines(frequency_figure([soft]).axes[0])
    assert len(drawn) == len(soft.changes) + 1
    for before, after, change in zip(drawn, drawn[1:], soft.changes, strict=False):
        assert tuple(points(before)[-1]) == tuple(points(after)[0])
        assert points(before)[-1] == pytest.approx((change.value, change.Omega), rel=1e-14)
        assert (before.get_label() == "stable") == change.stable_before
        assert (after.get_label() == "stable") == change.stable_after
    for line in drawn:
        assert (line.get_linestyle() == "-") == (line.get_label() == "stable")


def test_stretches_meet_midway_where_changes_were_not_located(soft: Branch) -> None:
    drawn = family_lines(frequency_figure([dataclasses.replace(soft, with_events=False)]).axes[0])
    flip = int(np.flatnonzero(np.diff(soft.stable))[0])
    middle = [soft.S[flip : flip + 2].mean(), soft.Omega[flip : flip + 2].mean()]
    assert points(drawn[0])[-1] == pytest.approx(middle)
    assert points(drawn[1])[0] == pytest.approx(middle)


def test_stretches_together_are_the_branch_in_its_order(soft: Branch) -> None:
    # The same orbits there and back, as on a branch with a fold: nothing is sorted or lost.
    folded = dataclasses.replace(soft, solutions=soft.solutions + soft.solutions[-2::-1], with_stability=False)
    (line,) = family_lines(frequency_figure([folded]).axes[0])
    assert np.array_equal(points(line)[1:], np.column_stack([folded.S, folded.Omega]))
    drawn = np.concatenate([points(line) for line in family_lines(frequency_figure([soft]).axes[0])])
    assert drawn[0] == pytest.approx((0.0, soft.start.Omega), abs=1e-14)
    assert np.all(np.diff(drawn[:, 0]) >= -1e-14)
    for S, Omega in drawn[1::97]:  # between points the curve is that of orbits corrected there
        assert Omega == pytest.approx(soft.at(S=float(S)).Omega, rel=1e-6)  # the tolerance of the family


def test_theory_requests_band_and_labels_are_drawn(soft: Branch, plain: Branch) -> None:
    figure = frequency_figure([soft, plain])
    axes = figure.axes[0]
    theory = lines(axes, "multiple scales, first order in $S$")
    assert len(theory) == 2
    S, Omega = points(theory[0]).T
    slope = multiple_scales.frequency_slope(8, 1.0, 0.25, -1.0, 1)
    assert Omega == pytest.approx(soft.start.Omega + slope * S, rel=1e-14)
    (requested,) = lines(axes, "requested")
    assert np.array_equal(points(requested)[:, 0], [0.2, 1.0, 2.0, 3.0])
    (band,) = [patch for patch in axes.patches if patch.get_label() == "linear band"]
    omegas = SOFT.linear_frequencies()
    low, high = axes.transData.inverted().transform(band.get_extents().get_points())[:, 1]
    assert (low, high) == pytest.approx((omegas[0], omegas[-1]))
    assert {text.get_text() for text in axes.texts} == {"$j = 1$", "$j = 3$"}
    assert {"stable", "unstable", "stability not computed", "change of stability"} <= legend_labels(figure)
    assert "$N = 8$" in axes.get_title()
    assert "dimensionless" in axes.get_title()


@pytest.mark.parametrize("sites", [6, slow(12)])
def test_labels_of_many_families_stay_apart_and_inside(sites: int) -> None:
    chain = Chain(sites, 1.0, 0.6, 1.0)
    branches = [follow_family(chain, j, 0.1, tolerance=1e-3, corrector="newton") for j in range(1, sites + 1)]
    figure = frequency_figure(branches)
    heights = sorted(text.xyann[1] for text in figure.axes[0].texts)
    assert len(heights) == sites
    assert min(np.diff(heights)) >= 0.048 - 1e-12
    assert heights[0] > -0.02
    assert heights[-1] <= 1.0
    colours = [tuple(line.get_color()) for line in family_lines(figure.axes[0])]
    grey = [float(np.dot(colour[:3], [0.299, 0.587, 0.114])) for colour in colours]
    assert np.all(np.diff(grey) > 0)


def test_a_family_that_hardly_moves_shows_its_shift() -> None:
    branch = follow_family(SOFT, 1, 1e-14, at=[1e-14], stability=True)
    figure = frequency_figure([branch])
    axes = figure.axes[0]
    assert r"\Omega - \omega_{1}" in axes.get_ylabel()
    (line,) = family_lines(axes)
    slope = multiple_scales.frequency_slope(8, 1.0, 0.25, -1.0, 1)
    assert points(line)[-1] == pytest.approx([1e-14, 1e-14 * slope], rel=1e-6, abs=0.0)
    figure.draw_without_rendering()
    assert "1e\N{MINUS SIGN}15" in axes.xaxis.get_offset_text().get_text()
    assert all(len(re.sub(r"[^0-9.]", "", label.get_text())) <= 4 for label in axes.get_yticklabels())


def test_branches_that_ended_early_say_so(plain: Branch) -> None:
    assert "ended early" not in legend_labels(frequency_figure([plain]))
    for kept in (1, 0):
        short = dataclasses.replace(plain, solutions=plain.solutions[:kept], end=None)
        figure = frequency_figure([short])
        assert "ended early" in legend_labels(figure)
        assert np.all(np.isfinite(points(family_lines(figure.axes[0])[0])))


# Profiles -----------------------------------------------------------------------------------------------------------


def test_profiles_have_norm_one_and_the_sign_of_the_linear_mode(soft: Branch, plain: Branch) -> None:
    figure = profile_figure([soft, plain])
    panel = figure.axes[0]
    assert panel.get_title(loc="left") == "$j = 1$"
    mode = points(lines(panel, "linear mode")[0])[:, 1]
    assert np.linalg.norm(mode) == pytest.approx(1.0)
    for orbit in soft.orbits:
        if orbit.point.requested:
            (line,) = lines(panel, f"$S = {orbit.S:g}$")
            y = points(line)[:, 1]
            assert np.abs(y) == pytest.approx(np.abs(orbit.profile) / np.sqrt(orbit.S))
            assert y @ mode > 0
    assert "$j = 3$" not in [axes.get_title(loc="left") for axes in figure.axes]  # nothing was requested of it


def test_profiles_that_are_not_steep_have_no_logarithmic_panel() -> None:
    branch = follow_family(Chain(4, 1.0, 0.1, 1.0), 1, 0.1, at=[0.1], tolerance=1e-3, corrector="newton")
    figure = profile_figure([branch])
    assert [axes.get_yscale() for axes in figure.axes] == ["linear"]


@pytest.mark.parametrize("sites", [400, slow(1000)])
def test_long_chains_are_lines_without_markers(sites: int) -> None:
    branch = follow_family(Chain(sites, 1.0, 0.25, 1.0), sites, 1e-3, at=[1e-3], tolerance=1e-2, tail="full")
    figure = profile_figure([branch])
    assert [axes.get_yscale() for axes in figure.axes] == ["linear", "log"]
    assert {line.get_marker() for axes in figure.axes for line in axes.get_lines()} == {"None"}
    assert figure.axes[0].get_xlim()[0] > sites - 200  # the sites that move; all of them on the logarithmic scale
    assert figure.axes[1].get_xlim() == (0.5, sites + 0.5)


def test_a_chain_without_its_tail_is_drawn_at_its_core() -> None:
    branch = follow_family(Chain(1000, 1.0, 0.25, 1.0), "last", 1e-3, at=[1e-3], tolerance=1e-2)
    figure = profile_figure([branch])
    core = branch.space.coordinates.core.cells
    assert figure.axes[1].get_xlim() == (1000.5 - core, 1000.5)


def test_passages_of_the_same_amplitude_are_told_apart(soft: Branch) -> None:
    requested = tuple(orbit for orbit in soft.orbits if orbit.point.requested)
    figure = profile_figure([dataclasses.replace(soft, solutions=(requested[0], requested[0]))])
    assert {"$S = 0.2$", "$S = 0.2$ (passage 2)"} <= legend_labels(figure)


# Multipliers --------------------------------------------------------------------------------------------------------


def test_multipliers_leave_the_circle_at_the_changes(soft: Branch) -> None:
    figure = multiplier_figure(soft)
    moduli, angles, *planes = figure.axes
    (largest,) = lines(moduli, r"largest $\left|\lambda\right|$")
    S, heights = points(largest).T
    for change in soft.changes:
        beside = np.interp(change.value + (1e-9 if change.stable_before else -1e-9), S, heights)
        assert heights[np.argmin(np.abs(S - change.value))] == pytest.approx(1.0, abs=1e-6)
        assert beside > 1.0
    ticks = [segment[0, 0] for lines in moduli.collections for segment in lines.get_segments()]
    assert sorted(ticks) == [change.value for change in soft.changes]
    marks = [line for line in angles.get_lines() if str(line.get_label()).startswith("stability changes")]
    assert sum(len(points(line)) for line in marks) == len(soft.changes)
    assert [re.split("  |, ", axes.get_title(loc="left"))[1] for axes in planes] == ["$S = 0.2$", "$S = 2$", "$S = 3$"]
    kinds = ("on the unit circle", "real, off the circle", "complex, off the circle")
    for axes in planes:
        assert axes.get_aspect() == 1.0
        drawn = sum(len(points(line)) for kind in kinds for line in lines(axes, kind))
        outside = [text.get_text().split()[0] for text in axes.texts]
        assert drawn + sum(map(int, outside)) == 2 * SOFT.sites - 2


def test_there_is_nothing_to_draw_without_stability_or_requests(plain: Branch, soft: Branch) -> None:
    assert multiplier_figure(plain) is None
    assert multiplier_figure(dataclasses.replace(soft, solutions=())) is None
    assert profile_figure([plain]) is None


# Special chains -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("sites", "gamma", "mode"), [(1, 0.3, 1), slow(4, -1.0, 4)])
def test_chains_without_a_band(sites: int, gamma: float, mode: int) -> None:
    branch = follow_family(Chain(sites, 1.0, gamma, 1.0), mode, 1.0, at=[1.0], stability=True, tolerance=1e-4)
    figure = frequency_figure([branch])
    assert "linear frequency" in legend_labels(figure)
    theory = points(lines(figure.axes[0], "multiple scales, first order in $S$")[0])
    assert theory[1, 1] - theory[0, 1] == pytest.approx(3.0 / (8.0 * np.sqrt(3.0)))  # the site alone
    assert profile_figure([branch]) is not None
    assert multiplier_figure(branch) is not None


@pytest.mark.parametrize("chain", [Chain(1, 1.0, 0.0, 1.0), Chain(1000, 1.0, 0.25, 1.0), Chain(5, 1.0, 1.0, 1.0)])
def test_spectrum(chain: Chain) -> None:
    axes, *modes = spectrum_figure(chain).axes
    drawn = points(axes.get_lines()[0])
    assert drawn[:, 1] == pytest.approx(chain.linear_frequencies())
    assert len(axes.texts) == 2
    assert [panel.get_ylabel() for panel in modes] == [f"$u_{{{j},n}}$" for j in dict.fromkeys([chain.sites, 1])]


def test_spectrum_leaves_out_modes_that_do_not_oscillate() -> None:
    chain = Chain(24, -1.0, 0.1, 1.0)
    squares = chain.diagonalise()[0]
    drawn = points(spectrum_figure(chain).axes[0].get_lines()[0])[:, 1]
    assert np.array_equal(np.isfinite(drawn), squares > 0)


# Places -------------------------------------------------------------------------------------------------------------


SLOWER = ("several", "multipliers", "square", "steep")


@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
@pytest.mark.parametrize("draw", ["frequency", "shift", "profile", *(slow(name) for name in SLOWER)])
def test_no_text_covers_another(draw: str, soft: Branch, plain: Branch) -> None:
    def drawn() -> Figure | None:
        if draw == "shift":  # a power of ten above the axis, and long labels
            return frequency_figure([follow_family(SOFT, 8, 1e-7, tolerance=1e-4)])
        if draw == "several":
            return frequency_figure([soft, plain, follow_family(SOFT, 8, 0.02, tolerance=1e-4)])
        if draw == "square":  # two square panels, which the width of the figure bounds, and nearly its height
            return multiplier_figure(follow_family(SOFT, 1, 0.4, stability=True, events=False, tolerance=1e-4))
        if draw == "steep":
            return profile_figure([follow_family(Chain(20, 1.0, 0.99999, -1.0), 1, 0.01, at=[0.01], tolerance=1e-4)])
        return {"profile": profile_figure, "frequency": frequency_figure}.get(
            draw, lambda branches: multiplier_figure(branches[0])
        )([soft])

    figure = drawn()
    assert overlaps(figure) == []
    panels = [axes.get_position() for axes in figure.axes]
    assert sum(panel.width * panel.height for panel in panels) > 0.4  # of the figure


# Files --------------------------------------------------------------------------------------------------------------


def without_numbers() -> Figure:
    """A line in a box with a letter, quickly drawn."""
    with style():
        figure = blank(1.0, 1.0)
        axes = figure.subplots()
        axes.set(xticks=[], yticks=[], xlabel="a")
        axes.plot([0.0, 1.0], [0.0, 1.0], label="b")
        return finished(figure, [axes], 1)


@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
@pytest.mark.parametrize("draw", [without_numbers, slow(lambda: spectrum_figure(Chain(1, 1.0, 0.0, 1.0)))])
def test_files_are_the_same_bytes_whatever_the_settings(tmp_path: Path, draw: Callable[[], Figure]) -> None:
    before = dict(matplotlib.rcParams)
    figure = draw()
    formats = ("png", "svg", "pdf")
    first = save(figure, tmp_path / "spectrum.v1", formats)
    assert dict(matplotlib.rcParams) == before
    assert [path.name for path in first] == [f"spectrum.v1.{kind}" for kind in formats]
    contents = [path.read_bytes() for path in first]
    with matplotlib.rc_context({"font.size": 20.0, "xtick.direction": "out", "savefig.bbox": "tight"}):
        other = save(draw(), tmp_path / "other", formats)
    assert [path.read_bytes() for path in other] == contents
    assert [path.read_bytes() for path in save(figure, tmp_path / "other", formats)] == contents  # replaced
    assert len(list(tmp_path.iterdir())) == 6
    assert first[0].read_bytes().startswith(b"\x89PNG")
    assert b"<dc:date>" not in first[1].read_bytes()


@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
def test_a_png_says_its_resolution_and_not_who_wrote_it(tmp_path: Path) -> None:
    (path,) = save(without_numbers(), tmp_path / "own")
    with Image.open(path) as image:
        assert image.size == (200, 200)
        assert image.info.keys() == {"dpi"}
        assert image.info["dpi"] == pytest.approx((200.0, 200.0), abs=0.01)
        assert np.ptp(np.asarray(image)[..., :3]) > 100


def test_a_failed_write_leaves_the_old_files_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "f.png").write_bytes(b"old")

    def fail(path: Path, data: bytes) -> None:
        path.write_text("half", encoding="utf-8")
        raise OSError("no space left")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="no space"):
        save(Figure(), tmp_path / "f")
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == ["f.png"]
    assert (tmp_path / "f.png").read_bytes() == b"old"


def test_a_family_that_ends_early_is_in_the_frame_of_logarithmic_shifts(plain: Branch) -> None:
    short = follow_family(SOFT, 8, 1e-4, tolerance=1e-4)
    axes = frequency_figure([plain, short]).axes[1]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert len(axes.texts) == 2
    for text in axes.texts:
        S, shift = text.xy
        assert left < S <= right
        assert low < shift < high
    for line in family_lines(axes):
        S, shifts = points(line).T
        seen = left <= S
        assert np.count_nonzero(seen) > 1
        assert np.all((shifts[seen] > low) & (shifts[seen] < high))


def test_modes_that_hardly_move_are_shown_by_their_shifts_too(plain: Branch, soft: Branch) -> None:
    first = follow_family(SOFT, 1, 0.02, tolerance=1e-4)
    last = follow_family(SOFT, 8, 0.02, tolerance=1e-4)
    figure = frequency_figure([first, last])
    drawn = family_lines(figure.axes[1])
    assert [points(line)[-1, 1] for line in drawn] == [branch.orbits[-1].Omega_shift for branch in (first, last)]
    assert len(frequency_figure([soft, plain]).axes) == 1  # of which both move


def test_no_axis_counts_from_an_offset() -> None:
    with style():
        figure = blank(4.0, 3.0)
        axes = figure.add_subplot()
        axes.plot([0, 1], [1.0, 1.0 + 1e-6])
        figure.canvas.draw()
        assert axes.yaxis.get_offset_text().get_text() == ""
