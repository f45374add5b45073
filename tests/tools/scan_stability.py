"""Scan families of the chain for changes of stability, independently of the package: what tests compare it with.

Nothing of the package is imported. Orbits are odd cosine series at Chebyshev points of panels in S, found by Newton's
method on sparse equations; the variational flow over a quarter of the period is a composition of Verlet steps of order
8 (Kahan and Li 1997) in fixed steps; stability is read off the eigenvalues of B^T C. The scan goes in even steps of S.
Between two stable points where the order of Krein signatures along the mu axis differs, two multipliers have passed
each other: halving then looks for the window in which they are off the circle, however narrow. Edges of windows are
halved to `RESOLUTION`. What rounding makes of a place is measured: how far from an edge flows of two step sizes still
tell the wrong side of it.

    python tests/tools/scan_stability.py NAME ...      # writes tests/data/stability_changes/NAME.json
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.sparse import bmat, csc_matrix, diags, identity, kron
from scipy.sparse.linalg import splu

DATA = Path(__file__).parents[1] / "data" / "stability_changes"
RESOLUTION = 2e-10
OUTSIDE = 2e-11  # imaginary part of mu: what counts as off the real axis
NEAR_ENDS = 1e-5
ORBIT_ERROR = 1e-11
BATCH_ENTRIES = 20_000
COARSE, FINE = 10, 32  # steps a quarter of the period: of the scan, and of all that is looked at closely
OTHER = 39  # steps of another flow, for errors of places
DOUBLINGS = 13  # of RESOLUTION, up to which an edge is asked on which side of it a place is
PANEL_NODES = 17
# Kahan and Li (1997), 17 stages, order 8; as in Hairer, Lubich and Wanner, Geometric Numerical Integration, V.3.2.
HALF = (
    0.13020248308889008087881763,
    0.56116298177510838456196441,
    -0.38947496264484728640807860,
    0.15884190655515560089621075,
    -0.39590389413323757733623154,
    0.18453964097831570709183254,
    0.25837438768632204729397911,
    0.29501172360931029887096624,
)
WEIGHTS = np.array([*HALF, -0.60550853383003451169892108, *HALF[::-1]])


@dataclass(frozen=True)
class Family:
    """A family of the chain, from linear mode `mode` to S = `S_max`, scanned in steps of `step`."""

    sites: int
    alpha: float
    gamma: float
    g: float
    mode: int
    S_max: float
    step: float = 3e-4
    harmonics: int = 20


FAMILIES = {
    **{f"hardening_{j}": Family(24, 1.0, 0.25, 1.0, j, 3.0) for j in (1, 6, 10, 14, 18, 24)},
    **{f"softening_{j}": Family(24, 1.0, 0.25, -1.0, j, 3.0) for j in (6, 10, 14, 18, 24)},
    "softening_1": Family(24, 1.0, 0.25, -1.0, 1, 3.0, 1e-4),
    "strong_softening_16": Family(16, 2.0, 0.6, -1.0, 1, 3.4, 1e-4),
    "long_softening_60": Family(60, 1.0, 0.25, -1.0, 1, 2.6, 4e-4),
    "weak_gamma_16_01": Family(16, 0.5, 0.1, -1.0, 1, 0.75, 1e-4),
    "weak_gamma_16_02": Family(16, 0.5, 0.2, -1.0, 1, 1.0),
    "weak_gamma_16_03": Family(16, 0.5, 0.3, -1.0, 1, 1.0),
    "short_hardening_8": Family(8, 0.1, 0.7, 1.0, 8, 3.0),
    "longest_hardening_100": Family(100, 4.0, 0.4, 1.0, 100, 0.4, 4e-4, 10),
    "reciprocal_12": Family(12, 4.0, 0.0, 1.0, 3, 3.0),
    "reciprocal_8": Family(8, 1.0, 0.0, -1.0, 1, 1.5),
    "interior_32": Family(32, 1.0, 0.5, 1.0, 5, 2.0),
    "soft_onsite_40": Family(40, 0.3, 0.15, -1.0, 1, 0.25, 5e-5),
    "last_softening_20": Family(20, 1.0, 0.4, -1.0, 20, 1.5),
}


class Orbits:
    """Orbits q'' = -L q - kappa w q^3, sum w q(0)^2 = 1, kappa = g S, as polynomials in S on panels."""

    def __init__(self, family: Family) -> None:
        self.family = family
        N, H = family.sites, family.harmonics
        ratio = np.log((1.0 + family.gamma) / (1.0 - family.gamma))
        n = np.arange(1, N + 1)
        self.weights = np.exp(ratio * (n - N))
        self.coupling = np.sqrt(1.0 - family.gamma**2)
        self.L = diags([2.0 + family.alpha, -self.coupling, -self.coupling], [0, -1, 1], shape=(N, N), format="csc")
        k = 2 * np.arange(H) + 1
        theta = (np.arange(H) + 0.5) * np.pi / (2 * H)
        self.values = np.cos(np.outer(theta, k))
        self.to_coefficients = (2.0 / H) * self.values
        self.second = -(self.values * k**2) @ self.to_coefficients
        self.at_zero = self.to_coefficients.sum(axis=0)
        self.panels: list[tuple[float, float, BarycentricInterpolator]] = []
        self.error = 0.0
        self._follow()

    def _newton(self, S: float, guess: np.ndarray) -> np.ndarray:
        N, H, kappa = self.family.sites, self.family.harmonics, self.family.g * S
        z = guess.copy()
        linear = kron(self.L, identity(H))
        for _ in range(12):
            q, square = z[:-1].reshape(N, H), z[-1]
            bend = q @ self.second.T
            residual = square * bend + self.L @ q + kappa * self.weights[:, None] * q**3
            start = q @ self.at_zero
            defect = np.append(residual.ravel(), self.weights @ start**2 - 1.0)
            inner = square * kron(identity(N), csc_matrix(self.second)) + linear
            inner = inner + diags((3.0 * kappa * self.weights[:, None] * q**2).ravel())
            last = (2.0 * (self.weights * start)[:, None] * self.at_zero[None, :]).ravel()
            matrix = bmat([[inner, csc_matrix(bend.reshape(-1, 1))], [csc_matrix(last[None, :]), None]], format="csc")
            step = splu(matrix).solve(defect)
            z -= step
            if np.max(np.abs(step)) < 1e-13 * np.max(np.abs(z)):
                break
        size = np.max(np.abs(z - guess)) / np.max(np.abs(z))
        if not size < 0.05:
            raise ArithmeticError(f"S = {S}: Newton moved by {size:.2g}")
        return z

    def _follow(self) -> None:
        family = self.family
        N, n = family.sites, np.arange(1, family.sites + 1)
        mode = np.sin(n * np.pi * family.mode / (N + 1))
        mode /= np.sqrt(self.weights @ mode**2)
        theta = (np.arange(family.harmonics) + 0.5) * np.pi / (2 * family.harmonics)
        square = 2.0 + family.alpha - 2.0 * self.coupling * np.cos(np.pi * family.mode / (N + 1))
        z = np.append(np.outer(mode, np.cos(theta)).ravel(), square)
        points = 0.5 - 0.5 * np.cos(np.pi * np.arange(PANEL_NODES) / (PANEL_NODES - 1))
        start, length = 0.0, min(0.05, family.S_max)
        history = [(0.0, z)]
        while start < family.S_max - 1e-12:
            length = min(length, family.S_max - start)
            places = start + length * points
            try:
                orbits = []
                for S in places:
                    guess = _extrapolated(history + list(zip(places, orbits, strict=False)), S)
                    orbits.append(self._newton(float(S), guess))
                interpolant = BarycentricInterpolator(places, np.array(orbits))
                middle = 0.5 * (places[7] + places[8])
                orbit = self._newton(middle, interpolant(middle))
                error = np.max(np.abs(interpolant(middle) - orbit)) / np.max(np.abs(orbit))
            except ArithmeticError:
                error = np.inf
            if error > ORBIT_ERROR:
                length *= 0.5
                if length < 1e-9:
                    raise ArithmeticError(f"the family ends near S = {start}")
                continue
            self.error = max(self.error, float(error))
            self.panels.append((start, start + length, interpolant))
            history = list(zip(places, orbits, strict=True))[-4:]
            start, length = start + length, length * (1.8 if error < 0.1 * ORBIT_ERROR else 1.0)

    def at(self, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (points, sites, harmonics) and frequencies (points,)."""
        ends = np.array([panel[1] for panel in self.panels])
        which = np.minimum(np.searchsorted(ends, S), len(ends) - 1)
        z = np.empty((S.size, self.family.sites * self.family.harmonics + 1))
        for k in np.unique(which):
            z[which == k] = self.panels[k][2](S[which == k])
        q = z[:, :-1].reshape(S.size, self.family.sites, self.family.harmonics)
        return q @ self.to_coefficients, np.sqrt(z[:, -1])


def _extrapolated(history: list, S: float) -> np.ndarray:
    known = []
    for place, z in history[::-1]:
        if all(abs(place - other) > 1e-12 for other, _ in known):
            known.append((place, z))
        if len(known) == 4:
            break
    result = np.zeros_like(known[0][1])
    for i, (a, z) in enumerate(known):
        result += z * np.prod([(S - b) / (a - b) for j, (b, _) in enumerate(known) if j != i])
    return result


class Stability:
    """mu and signatures at any S."""

    def __init__(self, orbits: Orbits) -> None:
        self.orbits, self.family, self.count = orbits, orbits.family, 0

    def transitions(self, S: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Phi over a quarter of the period (points, 2N, 2N), and the acceleration at phase zero (points, N)."""
        orbits, N = self.orbits, self.family.sites
        coefficients, Omega = orbits.at(S)
        h = (np.pi / 2.0 / Omega / steps)[:, None, None]
        k = 2 * np.arange(self.family.harmonics) + 1
        X, V = np.zeros((2, S.size, N, 2 * N))
        X[:, range(N), range(N)] = 1.0
        V[:, range(N), range(N, 2 * N)] = 1.0
        cubic = 3.0 * self.family.g * S[:, None] * orbits.weights
        drift, phase, force = 0.0, 0.0, np.empty_like(X)
        for _ in range(steps):
            for weight in WEIGHTS:
                drift += 0.5 * weight
                X += (drift * h) * V
                phase += 0.5 * weight
                q = coefficients @ np.cos(k * (phase * np.pi / 2.0 / steps))
                phase += 0.5 * weight
                np.multiply((2.0 + self.family.alpha + cubic * q * q)[:, :, None], X, out=force)
                force[:, 1:] -= orbits.coupling * X[:, :-1]
                force[:, :-1] -= orbits.coupling * X[:, 1:]
                V -= (weight * h) * force
                drift = 0.5 * weight
            # The half drift at the end of a step joins that at the start of the next.
        X += (drift * h) * V
        start = coefficients.sum(axis=2)
        acceleration = -(orbits.L @ start.T).T - self.family.g * S[:, None] * orbits.weights * start**3
        return np.concatenate([X, V], axis=1), acceleration

    def spectra(self, S: np.ndarray, steps: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """mu in order of their real parts, signatures, and which are outside; without the trivial one."""
        N, found = self.family.sites, []
        batch = max(1, BATCH_ENTRIES // (2 * N * N))
        for first in range(0, S.size, batch):
            Phi, a = self.transitions(S[first : first + batch], steps)
            A, B, C, D = Phi[:, :N, :N], Phi[:, :N, N:], Phi[:, N:, :N], Phi[:, N:, N:]
            for i in range(len(Phi)):
                frame = np.linalg.svd(a[i][None, :])[2][1:].T
                K = frame.T @ (B[i].T @ (C[i] @ frame))
                P = frame.T @ (A[i].T @ (C[i] @ frame))
                Q = frame.T @ (B[i].T @ (D[i] @ frame))
                mu, x = np.linalg.eig(K)
                y = np.linalg.inv(x)
                form = np.real(np.sum(x * (P @ x), axis=0))
                # mu (1 + mu) = (x^T P x) (y^T Q y): its sign is better known there than mu is next to -1 and 0.
                product = form * np.real(np.sum(y * (y @ Q), axis=1))
                near = np.abs(mu * (1.0 + mu)) < NEAR_ENDS
                off = np.where(near, product, np.real(mu * (1.0 + mu))) > 0.0
                off = np.where(mu.imag == 0.0, off, np.abs(mu.imag) > OUTSIDE)
                order = np.argsort(mu.real, kind="stable")
                found.append((np.asarray(mu[order], complex), -np.sign(form[order]).astype(int), off[order]))
        self.count += S.size
        return found

    def states(self, S: np.ndarray, steps: int) -> list[tuple[bool, tuple[int, ...], float]]:
        """Whether stable, the signatures along the mu axis, and log |multiplier| over the period of the worst."""
        result = []
        for mu, signatures, off in self.spectra(S, steps):
            growth = np.abs(4.0 * np.log(np.abs(np.sqrt(mu) + np.sqrt(mu + 1.0))))
            result.append((not off.any(), tuple(signatures.tolist()), float(np.max(growth[off], initial=0.0))))
        return result


def _differ(first: tuple[bool, tuple[int, ...], float], second: tuple[bool, tuple[int, ...], float]) -> bool:
    """Whether something happens between two states: a change of stability, or a passage of opposite signatures."""
    return first[0] != second[0] or (first[0] and first[1] != second[1])


def scan(family: Family) -> dict[str, object]:
    """All that is found on a family."""
    orbits = Orbits(family)
    stability = Stability(orbits)
    some = np.linspace(0.05, 1.0, 8) * family.S_max
    flow_error = float(np.max(np.abs(stability.transitions(some, FINE)[0] - stability.transitions(some, 2 * FINE)[0])))
    S = np.linspace(0.0, family.S_max, round(family.S_max / family.step) + 1)[1:]
    coarse = stability.states(S, COARSE)
    differs = [i for i in range(S.size - 1) if _differ(coarse[i], coarse[i + 1])]
    again = sorted({k for i in differs for k in range(max(i - 1, 0), min(i + 3, S.size))})
    fine = dict(zip(again, stability.states(S[again], FINE), strict=True)) if again else {}
    states = {place: fine.get(i, coarse[i]) for i, place in enumerate(S.tolist())}
    waiting = list(zip(S[:-1].tolist(), S[1:].tolist(), strict=True))
    edges, passed = [], []
    while True:
        interesting = []
        for a, b in waiting:
            if not _differ(states[a], states[b]):
                continue
            if b - a > RESOLUTION:
                interesting.append((a, b))
            elif states[a][0] != states[b][0]:
                edges.append([a, b, states[b][0]])
            else:
                passed.append(0.5 * (a + b))
        if not interesting:
            break
        middles = np.array([0.5 * (a + b) for a, b in interesting])
        states.update(zip(middles.tolist(), stability.states(middles, FINE), strict=True))
        waiting = [part for (a, b), m in zip(interesting, middles.tolist(), strict=True) for part in ((a, m), (m, b))]
    edges.sort()
    errors = edge_errors(stability, edges)
    passed = [S for S in passed if all(abs(S - 0.5 * (a + b)) > e for (a, b, _), e in zip(edges, errors, strict=True))]
    growths = [state[2] for _, state in sorted(states.items())]
    places = np.array(sorted(states))
    depths = []
    stops = [0.0, *[edge[0] for edge in edges], family.S_max]
    for a, b in pairwise(stops):
        inside = (places > a) & (places <= b)
        depths.append(float(np.max(np.array(growths)[inside], initial=0.0)))
    return {
        "family": {k: getattr(family, k) for k in ("sites", "alpha", "gamma", "g", "mode", "S_max", "step")},
        "edges": [[*edge, error] for edge, error in zip(edges, errors, strict=True)],
        "depths": depths,
        "passed": sorted(passed),
        "orbit_error": orbits.error,
        "flow_error": flow_error,
        "points": stability.count,
    }


def edge_errors(stability: Stability, edges: list) -> list[float]:
    """How far from each edge a place may be on the wrong side of it, by rounding and by the flow's steps."""
    places, expected, owners, away = [], [], [], []
    for i, (a, b, stable) in enumerate(edges):
        before = edges[i - 1][1] if i else 0.0
        after = edges[i + 1][0] if i + 1 < len(edges) else stability.family.S_max
        for distance in RESOLUTION * 2.0 ** np.arange(DOUBLINGS + 1):
            sides = ((a - distance, not stable, a - before), (b + distance, stable, after - b))
            for place, state, room in sides:
                if distance < 0.5 * room:
                    places.append(place)
                    expected.append(state)
                    owners.append(i)
                    away.append(distance)
    errors = [RESOLUTION] * len(edges)
    for steps in (FINE, OTHER) if places else ():
        for state, wanted, i, distance in zip(
            stability.states(np.array(places), steps), expected, owners, away, strict=True
        ):
            if state[0] != wanted:
                errors[i] = max(errors[i], 2.0 * float(distance))
    return errors


def main() -> None:
    """Scan the families named on the command line, all of them where none is."""
    for name in sys.argv[1:] or FAMILIES:
        clock = time.time()
        result = scan(FAMILIES[name])
        DATA.mkdir(parents=True, exist_ok=True)
        (DATA / f"{name}.json").write_text(json.dumps(result, indent=None, separators=(",", ":")) + "\n")
        words = f"{len(result['edges'])} edges, {len(result['passed'])} passed, {time.time() - clock:.0f} s"
        print(name, words, flush=True)


if __name__ == "__main__":
    main()
