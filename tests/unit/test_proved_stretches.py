"""Proofs of whole families: they hold where orbits and operators are looked at one by one, and end at branch points."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from cosine_operators import explicit, explicit_residual, norm
from small_models import two_wells

from casadi_skin import Chain, OdeModel, follow_family

flint = pytest.importorskip("flint")

from casadi_skin.certify import balls
from casadi_skin.certify import stretch as polynomial_piece
from casadi_skin.certify.bounds import FiniteInverse, proved_radius
from casadi_skin.certify.certify import attempt_near, distance, provable, step_of
from casadi_skin.certify.stretch import _fault, _joined, _only_one, _piece, _Stretch, piece_constants
from casadi_skin.certify.system import system_of

NU = 1.02


def family(model, S, mode=1, **options):
    return follow_family(model, mode=mode, amplitude_max=S, tolerance=1e-10, **options)


def stretch_of(branch, end):
    whole = provable(branch.space)
    return _Stretch(branch, whole, system_of(whole.coordinates, 1.0, step_of(whole)), flint.arb(NU), end)


@pytest.mark.parametrize("g", [1.0, -1.0])
def test_a_chain_s_family_is_proved_from_its_linear_mode(g):
    branch = family(Chain(4, 1.0, 0.25, g), 2.0, mode=3)
    proof = branch.certify(0.0, 2.0)
    assert proof.complete
    assert (proof.S_start, proof.S_end) == (0.0, 2.0)
    assert proof.pieces == len(proof.breaks) + 1 < 6
    assert 0.0 < proof.radius < 0.1
    assert branch.certify(1.0, 1.5).complete


@pytest.mark.slow
@pytest.mark.parametrize(("g", "mode"), [(-1.0, 18), (1.0, 6)])
def test_families_of_figure_3_are_one_curve_each(g, mode):
    """In the first the largest site changes, and with it the sign of what is shown."""
    proof = family(Chain(24, 1.0, 0.25, g), 3.0, mode=mode).certify(0.0, 3.0)
    assert proof.complete
    assert proof.pieces < 8


@pytest.mark.slow
def test_a_stretch_ends_before_a_branch_point():
    """Two equal sites in antiphase: v = cn dn solves the linearised equations (Lame's) where m = 1/8, S = 8/3."""
    branch = family(Chain(2, 1.0, 0.0, 1.0), 4.0, mode=2)
    proof = branch.certify(1.0, 3.0)
    assert not proof.complete
    assert 2.5 < proof.S_end < 8.0 / 3.0
    assert "no piece beyond S = 2.6" in proof.reason
    beyond = branch.certify(2.8, 3.2)
    assert beyond.complete


def soft():
    """y'' = -y - y^2: its orbits are sums of all cosines."""
    y, v = ca.SX.sym("y"), ca.SX.sym("v")
    return OdeModel(
        "y + y^2", y, -y - y**2, order=2, velocity=v, reversal=(1, -1), hamiltonian=v**2 / 2 + y**2 / 2 + y**3 / 3
    )


@pytest.mark.parametrize(("model", "S"), [pytest.param(soft(), 0.1, marks=pytest.mark.slow), (two_wells(), 0.02)])
def test_families_of_all_cosines_are_proved_from_their_linear_mode(model, S):
    proof = family(model, S).certify(0.0, S)
    assert proof.complete


def test_true_orbits_lie_within_the_radius_of_the_curve_at_any_s():
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        stretch = stretch_of(family(Chain(3, 1.0, 0.25, -1.0), 2.5), 2.5)
        piece = _piece(stretch, 0.5, 2.0, 9)
        halved = replace(piece.constants, Y=0.5 * piece.constants.Y)
        largest = 0.0
        for x in np.linspace(-1.0, 1.0, 21).tolist():
            centre = piece.curve.at(flint.arb(x))
            wide = [[*row, *[flint.arb(0)] * 14] for row in centre.coefficients]
            true = attempt_near(type(centre)(centre.system, centre.square.mid(), wide), stretch.nu)
            assert true.radius < 1e-9
            largest = max(largest, distance(centre, true.series, stretch.nu))
        assert largest <= piece.radius
        assert proved_radius(halved) < piece.radius


def test_bounds_at_any_place_are_below_those_of_the_piece():
    """With far fewer nodes than the polynomials need the largest value between them would be missed."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        stretch = stretch_of(family(Chain(3, 1.0, 0.25, -1.0), 2.5), 2.5)
        curve = stretch.curve(0.2, 2.2, 6)
        curve = replace(curve, inverse=curve.inverse * np.where(np.arange(11) < 4, 1.0, 0.0)[:, None, None])
        constants = piece_constants(curve, stretch.nu)
        Z, W = 0.0, 0.0
        for x in np.linspace(-1.0, 1.0, 33).tolist():
            node = curve.bounds_at(flint.arb(x), stretch.nu)
            T = [float(t) for t in curve.chebyshev(flint.arb(x))]
            bounds = FiniteInverse(curve.at(flint.arb(x)), stretch.nu, np.tensordot(T, curve.inverse, axes=1))
            Z = max(Z, node.finite, bounds.Z())
            W = max(W, bounds.W(constants.reach))
        assert 0.25 * constants.Z < Z <= constants.Z
        assert 0.25 * constants.W < W <= constants.W


def short_piece(stretch, harmonics):
    """Parabolas on a short interval far from S = 0, about which bounds hardly change from one place to another."""
    curve = stretch.curve(0.10 * stretch.end, 0.12 * stretch.end, harmonics)
    return replace(curve, centre=curve.centre[:3], inverse=curve.inverse[:3], factor=curve.factor[:3])


def largest_along(curve, nu, harmonics=20):
    """The largest |A F| and |I - A DF| at places of a piece, from explicit matrices on many harmonics."""
    Y, Z = 0.0, 0.0
    for x in np.linspace(-1.0, 1.0, 9).tolist():
        T, series = [float(t) for t in curve.chebyshev(flint.arb(x))], curve.at(flint.arb(x))
        bounds = FiniteInverse(series, nu, np.tensordot(T, curve.inverse[: len(T)], axes=1))
        A, DF, weights = explicit(bounds, harmonics, factor=np.dot(T, curve.factor))
        Y = max(Y, weights @ np.abs(A @ explicit_residual(series, harmonics)))
        Z = max(Z, norm(np.eye(len(DF)) - A @ DF, weights))
    return Y, Z


@pytest.fixture
def many_nodes(monkeypatch):
    """So many nodes that the largest values between them are bounded by hardly more than those at them."""
    monkeypatch.setattr(polynomial_piece, "MORE_NODES", 6.0)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        yield


@pytest.mark.usefixtures("many_nodes")
@pytest.mark.parametrize(("model", "S", "harmonics"), [(Chain(1, 1.0, 0.0, 1.0), 0.4, 3), (soft(), 0.1, 6)])
def test_each_term_of_z_is_needed_along_a_piece(model, S, harmonics):
    """One by one the rows of the tail, the finite rows and the factor of the tail's rows are what Z is made of."""
    stretch = stretch_of(family(model, S), S)
    good = short_piece(stretch, harmonics)
    for curve in (good, replace(good, inverse=0.6 * good.inverse), replace(good, factor=0.6 * good.factor)):
        Z = piece_constants(curve, stretch.nu).Z
        assert 0.8 * Z < largest_along(curve, stretch.nu)[1] <= Z


@pytest.mark.usefixtures("many_nodes")
@pytest.mark.parametrize(("model", "S", "harmonics"), [(Chain(1, 1.0, 0.0, 1.0), 0.4, 3), (soft(), 0.1, 6)])
def test_y_counts_what_the_finite_equations_are_off_by(model, S, harmonics):
    """With lambda shifted, and with the fundamental shifted."""
    stretch = stretch_of(family(model, S), S)
    good = short_piece(stretch, harmonics)
    for unknown in (0, 1 if stretch.system.step == 2 else 2):
        centre = good.centre.copy()
        centre[0, unknown] += 0.01
        curve = replace(good, centre=centre)
        Y = piece_constants(curve, stretch.nu).Y
        assert 0.8 * Y < largest_along(curve, stretch.nu)[0] <= Y


@pytest.mark.usefixtures("many_nodes")
def test_y_counts_the_harmonics_beyond_the_finite_part():
    """q = cos(theta), lambda = 3 + 3 S/4 is off by S/4 cos(3 theta) alone: one cosine's harmonic balance."""
    stretch = stretch_of(family(Chain(1, 1.0, 0.0, 1.0), 0.4), 0.4)
    curve = short_piece(stretch, 1)
    middle, half = 0.5 * (curve.start + curve.end), 0.5 * (curve.end - curve.start)
    curve = replace(curve, centre=np.array([[3.0 + 0.75 * middle, 1.0], [0.75 * half, 0.0], [0.0, 0.0]]))
    Y = piece_constants(curve, stretch.nu).Y
    assert 0.8 * Y < largest_along(curve, stretch.nu)[0] <= Y


def test_rounding_of_the_inverse_is_counted():
    """A_f has an entry in which large terms cancel: in doubles to nothing, or to something else than in truth."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        stretch = stretch_of(family(Chain(1, 1.0, 0.0, 1.0), 0.4), 0.4)
        flat = stretch.curve(0.1, 0.12, 1)
        centre, factor = np.vstack([flat.centre[:1], np.zeros((3, 2))]), np.append(flat.factor[:1], np.zeros(3))
        largest = 0.0
        for i in range(1, 23):
            x = flint.arb(i) / 23
            T1, T3 = x, 4 * x**3 - 3 * x
            inverse = np.concatenate([flat.inverse[:1], np.zeros((3, 2, 2))])
            inverse[:, 1, 1] = 0.0, -(2.0**50) * float(T3), 0.0, 2.0**50 * float(T1)
            exact = inverse[0].copy()
            exact[1, 1] = 2.0**50 * float(T3 * float(T1) - T1 * float(T3))
            largest = max(largest, abs(exact[1, 1]))
            curve = replace(flat, centre=centre, inverse=inverse, factor=factor)
            A, DF, weights = explicit(FiniteInverse(curve.at(x), stretch.nu, exact), 6)
            node = curve.bounds_at(x, stretch.nu)
            assert norm((np.eye(len(DF)) - A @ DF)[:2, :2], weights[:2]) <= node.finite
            assert np.all(weights[:2] @ np.abs(exact) <= node.norms)
        assert largest > 0.01


def test_a_polynomial_between_nodes_is_bounded():
    """cos(d phi) shifted to be largest between two nodes attains the factor nearly."""
    from casadi_skin.certify.stretch import _Uniform

    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        for count, degree in ((8, 5), (20, 13), (20, 19)):
            nodes = np.cos(np.pi * (2 * np.arange(count) + 1) / (2 * count))
            x = np.linspace(-1.0, 1.0, 20001)
            worst = 0.0
            for shift in np.linspace(0.0, np.pi, 50):
                p = np.polynomial.Chebyshev([0.0] * degree + [1.0]) * np.cos(shift)
                p -= np.polynomial.Chebyshev([0.0] * (degree - 1) + [1.0]) * np.sin(shift)
                worst = max(worst, np.max(np.abs(p(x))) / np.max(np.abs(p(nodes))))
            factor = float(_Uniform(None, None, [], count).between(degree))
            assert worst <= factor * (1.0 + 1e-9)
        # T_d at the nodes of T_M is largest where d/M is near 1: 1/cos(pi d/(2 M)) is attained by T_d for odd M
        assert np.isclose(float(_Uniform(None, None, [], 9).between(3)), 1.0 / np.cos(np.pi / 6.0))
        with pytest.raises(ArithmeticError, match="not bounded by 5 values"):
            _Uniform(None, None, [], 5).between(5)


@pytest.mark.slow
def test_pieces_of_two_families_are_not_joined():
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        one, other = (stretch_of(family(Chain(2, 1.0, 0.25, 1.0), 0.8, mode=m), 0.8) for m in (1, 2))
        first, second, strange = _piece(one, 0.2, 0.5, 5), _piece(one, 0.5, 0.8, 5), _piece(other, 0.5, 0.8, 5)
        assert _joined(first, second)
        assert not _joined(first, strange)
        assert not _joined(second, first)  # the ends do not meet
        assert not _fault(one, second, 0.7)
        assert "branch's orbit at S = 0.7" in _fault(one, strange, 0.7)
        linear = _piece(one, 0.0, 0.3, 5)
        assert not _fault(one, linear, 0.0)
        assert "linear mode" in _fault(one, _piece(other, 0.0, 0.3, 5), 0.0)
        assert not _only_one(second, 2.0 * second.constants.reach)


def test_stretches_that_make_no_sense_are_refused():
    branch = family(Chain(2, 1.0, 0.25, 1.0), 0.6)
    for start, end in ((0.5, 0.4), (-0.1, 0.3), (0.1, 0.7)):
        with pytest.raises(ValueError, match=r"start, end: given .*; accepted: 0 <= start < end <= 0\.6"):
            branch.certify(start, end)
