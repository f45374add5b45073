"""Proofs of chains with a linear tail: as those with every site, and bounds that hold the operator of all sites."""

from dataclasses import replace

import numpy as np
import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.lattice.chain_coordinates import FullChain, LongChain

flint = pytest.importorskip("flint")

from casadi_skin.certify import balls
from casadi_skin.certify.bounds import FiniteInverse
from casadi_skin.certify.system import CosineSeries, system_of, tailed_system

INFINITE = float("inf")


def family(chain, S, mode="first"):
    return follow_family(chain, mode=mode, amplitude_max=S, tolerance=1e-11)


@pytest.mark.parametrize(
    ("gamma", "g", "mode"), [(0.5, 1.0, "last"), pytest.param(-0.55, -1.0, "first", marks=pytest.mark.slow)]
)
def test_infinite_and_long_chains_are_proved_and_hold_what_all_sites_give(gamma, g, mode):
    whole = family(Chain(60, 1.0, gamma, g), 2.0, mode).at(S=2.0).certify()
    for sites in (INFINITE, 5000):
        orbit = family(Chain(sites, 1.0, gamma, g), 2.0, mode).at(S=2.0)
        certificate = orbit.certify()
        assert certificate.proved
        assert certificate.energy is None
        assert certificate.Omega[1] - certificate.Omega[0] < 2e-15
        assert max(certificate.Omega[0], whole.Omega[0]) <= min(certificate.Omega[1], whole.Omega[1])
        edge = slice(-5, None) if gamma > 0 else slice(0, 5)
        one, other = certificate.profile[:, edge], whole.profile[:, edge]
        assert np.all(np.maximum(one[0], other[0]) <= np.minimum(one[1], other[1]))


def test_an_orbit_whose_frequency_lies_in_the_band_is_not_proved():
    orbit = family(Chain(INFINITE, 1.0, -0.5, -1.0), 0.2).at(S=0.2)
    certificate = orbit.certify()
    assert not certificate.proved
    assert "Omega lies in the band" in certificate.reason
    assert "no proof that there is no orbit" in certificate.reason


def test_stability_and_stretches_of_tails_are_named_as_missing():
    branch = family(Chain(INFINITE, 1.0, 0.5, 1.0), 2.0, "last")
    assert "tail" in branch.at(S=2.0).proved_stability.reason
    with pytest.raises(ValueError, match="certify: given a chain with a tail that is no unknown; accepted"):
        branch.certify(1.0, 2.0)


def tailed(sites, core, S, harmonics, nu):
    """Bounds of a core, and the equations of all sites in the same scale."""
    chain = Chain(sites, 1.0, -0.3, -1.0)
    system = tailed_system(LongChain(chain, core, 1, S), S, False)
    orbit = follow_family(chain, mode=1, amplitude_max=S, tolerance=1e-10).at(S=S)
    columns = orbit.coefficients(40, np.arange(1, core + 1))[:harmonics].T.tolist()
    rows = [[(flint.arb(c) / d).mid() for c in column] for column, d in zip(columns, system.scale, strict=True)]
    scale = [system.scale[0] * system.tail.ratio.sqrt() ** n for n in range(sites)]
    whole = replace(system_of(FullChain(chain, 1), S), scale=scale)
    return FiniteInverse(CosineSeries(system, flint.arb(orbit.Omega**2), rows), flint.arb(nu)), whole


def explicit(bounds, whole, harmonics, shift=None):
    """A, DF, F and the weights on all sites and many harmonics in doubles, with products by quadrature."""
    series, N, J = bounds.series, whole.positions, harmonics
    M, H, square = series.system.positions, series.harmonics, float(series.square)
    odd, theta = 2.0 * np.arange(J) + 1.0, (np.arange(8 * J) + 0.5) * np.pi / (16 * J)
    cosines, scale = np.cos(np.outer(theta, odd)), np.array([float(d) for d in whole.scale])
    onsite, coupling, L = float(series.system.tail.onsite), float(series.system.tail.coupling), N - M
    a, near, chainlike = np.zeros((N, J)), np.zeros((H, L)), np.eye(L, k=1) + np.eye(L, k=-1)
    a[:M, :H] = [[float(x) for x in row] for row in series.coefficients]
    T = [(square * k**2 - onsite) * np.eye(L) + coupling * chainlike for k in odd[:H]]
    for i in range(H):
        a[M:, i] = near[i] = np.linalg.solve(T[i], -coupling * np.eye(L)[0] * a[M - 1, i])
    lam, at = square, a
    if shift is not None:
        lam, at = square + shift[0], a + shift[1:].reshape(N, J)
    q, cubic = at @ cosines.T, 1.0 * scale**2
    K = onsite * np.eye(N) - coupling * (np.eye(N, k=1) + np.eye(N, k=-1))
    forces = (-K @ q + cubic[:, None] * q**3) @ cosines * (2.0 / theta.size)
    F = np.concatenate([[np.sum((scale * at.sum(axis=1)) ** 2) - float(whole.S)], (lam * odd**2 * at + forces).ravel()])
    DF = np.zeros((1 + N * J, 1 + N * J))
    DF[0, 1:], DF[1:, 0] = np.repeat(2.0 * scale**2 * at.sum(axis=1), J), (odd**2 * at).ravel()
    DF[1:, 1:] = np.kron(-K, np.eye(J)) + np.diag(lam * np.tile(odd**2, N))
    for n in range(N):
        place = slice(1 + n * J, 1 + (n + 1) * J)
        DF[place, place] += cosines.T @ (3.0 * cubic[n] * q[n][:, None] ** 2 * cosines) * (2.0 / theta.size)
    finite = np.concatenate([[0], *(1 + m * J + np.arange(H) for m in range(M))])
    high = np.concatenate([1 + n * J + np.arange(H, J) for n in range(N)])
    A = np.zeros_like(DF)
    inertia = square * np.tile(odd**2, N)
    A[high, high] = 1.0 / inertia[high - 1]
    first = np.eye(1 + N * J)[finite]  # r_f - B T^-1 r_t - sum of the tail of harmonics
    slope = np.repeat(2.0 * scale**2 * a.sum(axis=1) * (np.arange(N) < M), J)
    first[0, high] -= slope[high - 1] / inertia[high - 1]
    for i in range(H):
        places = 1 + (M + np.arange(L)) * J + i
        first[1 + (M - 1) * H + i, places] -= coupling * np.linalg.inv(T[i])[0]
    A[finite] = bounds.matrix @ first
    for i in range(H):  # T^-1 (r_t - C x_f - x_lambda v)
        places, inverse = 1 + (M + np.arange(L)) * J + i, np.linalg.inv(T[i])
        A[np.ix_(places, places)] += inverse
        A[places] -= coupling * np.outer(inverse[:, 0], A[1 + (M - 1) * J + i])
        A[places] -= np.outer(inverse @ (odd[i] ** 2 * near[i]), A[0])
    weights = np.concatenate([[1.0], np.tile(float(bounds.nu) ** odd, N)])
    return A, DF, F, weights


def norm(matrix, weights):
    return float(np.max(weights @ np.abs(matrix) / weights))


@pytest.mark.parametrize(("core", "S", "harmonics"), [(3, 2.0, 4), (5, 1.2, 5)])
def test_bounds_hold_the_operator_of_all_sites(core, S, harmonics):
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds, whole = tailed(16, core, S, harmonics, 1.05)
        Y, Z, W = bounds.Y(), bounds.Z(), bounds.W(1e-3)
        finite, tail, curvature = bounds.finite_columns(), bounds.tailed, float(bounds.tailed.curvature(1e-3))
        derivatives = np.array([float(bounds.derivative_norm(n)) for n in range(core)])
        amplitude = bounds.series.system.tail.amplitude(bounds.series.tail_series, bounds.series.square)
    A, DF, F, weights = explicit(bounds, whole, 20)
    off = np.eye(len(DF)) - A @ DF
    own = np.concatenate([[0], *(1 + m * 20 + np.arange(harmonics) for m in range(core))])  # extended into the tail
    extended = np.concatenate([[0], *(1 + m * 20 + np.arange(harmonics) for m in range(16))])
    lengths = weights[extended] @ np.abs(A[np.ix_(extended, own)])
    assert np.all(lengths <= bounds.norms * (1.0 + 1e-12))
    assert np.max(lengths / bounds.norms) > 0.7
    places = np.arange(1 + core * 20)
    reached = weights[extended] @ np.abs(off[np.ix_(extended, places)]) / weights[places]
    assert 0.7 * finite < np.max(reached) <= 1.3 * finite
    assert norm(off, weights) <= Z
    assert float(weights @ np.abs(A @ F)) <= Y
    added = np.sum((DF[0, 1 + core * 20 :: 20]) ** 2 / (4.0 * np.array([float(d) for d in whole.scale[core:]]) ** 2))
    assert 0.2 * float(amplitude.upper()) < added <= float(amplitude.upper())
    columns = np.concatenate([1 + n * 20 + np.arange(harmonics) for n in range(core, 16)])
    sizes = weights @ np.abs(A[:, columns]) / weights[columns]
    assert 0.1 * float(tail.factor) < np.max(sizes) <= float(tail.factor)
    squares = np.max(sizes * np.tile((2.0 * np.arange(harmonics) + 1.0) ** 2, 16 - core))
    assert 0.1 * float(tail.square_factor) < squares <= float(tail.square_factor)
    beyond = slice(1 + core * 20, None)
    assert 0.3 * float(tail.residual) < float(weights[beyond] @ np.abs(F[beyond])) <= float(tail.residual)
    slopes = np.max(np.abs(DF[0, beyond]) / weights[beyond])
    assert 0.9 * float(tail.slope) < slopes <= float(tail.slope) * (1.0 + 1e-12)
    rows = np.arange(1, len(DF))
    inertia = np.diag(float(bounds.series.square) * np.tile((2.0 * np.arange(20) + 1.0) ** 2, 16))
    forces = weights[rows] @ np.abs(DF[1:, 1:] - inertia) / weights[rows]
    assert 0.9 * float(tail.derivative) < np.max(forces[core * 20 :]) <= float(tail.derivative)
    found = forces.reshape(16, 20)[:core].max(axis=1)  # the last has a neighbour in the tail
    assert np.all((0.8 * derivatives < found) & (found <= derivatives))
    first = slice(1 + core * 20, 1 + (core + 1) * 20)
    nearest = float(weights[first] @ np.abs(DF[first, 0] / (2.0 * np.arange(20) + 1.0) ** 2))
    second = 6.0 * float(whole.scale[core]) ** 2 * (nearest + 1e-3)  # derivative of q^3 times its factor
    assert 0.7 * curvature < second <= curvature
    cubic = DF[1 + core * 20 : 1 + (core + 1) * 20, 1 + core * 20 : 1 + (core + 1) * 20].copy()
    cubic[np.arange(20), np.arange(20)] -= inertia[0, 0] * (2.0 * np.arange(20) + 1.0) ** 2 - float(
        bounds.series.system.tail.onsite
    )
    low = weights[1:21] @ np.abs(cubic) / weights[1:21]
    assert 0.3 * float(tail.cubic_derivative) < np.max(low) <= float(tail.cubic_derivative)
    largest = 0.0
    for direction in [0, 1, 1 + 20 * (core - 1), 1 + 20 * core]:
        shift = np.zeros(len(DF))
        shift[direction] = 1e-3 / weights[direction]
        changed = A @ (explicit(bounds, whole, 20, shift)[1] - DF)
        largest = max(largest, norm(changed, weights) / 1e-3)
    assert 0.05 * W < largest <= W


def test_each_size_of_a_tail_enters_the_bounds():
    """Of a small part of a sum no operator shows that it is counted: each is made large, as in a tail that is."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = tailed(16, 3, 2.0, 4, 1.05)[0]
        small = bounds.tailed
        least = {
            ("residual", "Y"): small.factor,
            ("cubic_derivative", "Z"): small.factor,
            ("slope", "Z"): flint.arb(float(bounds.norms[0])),
            ("derivative", "Z"): bounds.tail_factor * bounds.beyond,
            ("factor", "W"): small.curvature(1e-3),
            ("square_factor", "W"): flint.arb(1),
            ("first", "W"): 6 * small.cubic * small.factor,
        }
        for (part, bound), share in least.items():
            bounds.tailed = replace(small, **{part: flint.arb(1000)})
            value = bounds.W(1e-3) if bound == "W" else getattr(bounds, bound)()
            assert value >= 1000.0 * float(share), part


def test_closed_forms_of_a_finite_tail():
    """Sums and shares of a tail of seven sites by solving its linear equations."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        tail, square, L = tailed(12, 5, 1.2, 4, 1.05)[0].series.system.tail, flint.arb(0.9), 7
        assert tail.length == L
        c, E = float(tail.coupling), float(tail.energy(1, square))
        u = np.linalg.solve(E * np.eye(L) + c * (np.eye(L, k=1) + np.eye(L, k=-1)), -c * np.eye(L)[0])
        assert np.isclose(float(tail.share(1, square)), u[0], rtol=1e-12)
        assert np.isclose(float(tail.squares(1, square)), np.sum(u**2), rtol=1e-12)
        assert np.all(np.abs(u) <= abs(float(tail.root(1, square))) ** np.arange(1, L + 1) * (1.0 + 1e-12))
        long = np.linalg.inv(E * np.eye(80) + c * (np.eye(80, k=1) + np.eye(80, k=-1)))
        assert 0.8 < np.max(np.abs(long).sum(axis=0)) * float(tail.gap(1, square)) <= 1.0
        endless = replace(tail, length=None)
        assert np.isclose(float(endless.share(1, square)), float(tail.root(1, square)))
