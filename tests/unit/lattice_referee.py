"""Periodic orbits and multipliers of declared lattices by other means: nothing here comes from the package.

Formulas are read by Python's own grammar, derivatives are complex steps, orbits solve a harmonic balance of all cosines
in physical positions, multipliers come from variational equations over the whole period by Dormand and Prince.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import quad, solve_ivp

NAMES: dict[str, Any] = {name: getattr(np, name) for name in ("sin", "cos", "tanh", "sinh", "exp", "log", "sqrt", "pi")}
STEP = 1e-30  # of derivatives in the complex plane, which rounds nothing
Array = np.ndarray


@dataclass(frozen=True)
class Referee:
    """A lattice of sites (name, onsite, mass) and bonds (start, end, offset, force, gains) as they are declared."""

    cells: tuple[int, ...]
    sites: Sequence[tuple[str, str, str]]
    bonds: Sequence[tuple[str, str, tuple[int, ...], str, tuple[str, str]]]
    boundary: tuple[str, ...]
    parameters: Mapping[str, Any]

    def value(self, text: str, cell: tuple[int, ...]) -> Any:
        """A formula in parameters; a function where it has an argument in front, as in "y: y^3"."""
        names = NAMES | dict(zip("nm", (k + 1.0 for k in cell), strict=False))
        names |= {k: v if isinstance(v, float | int) else np.array(v)[cell] for k, v in self.parameters.items()}
        return eval(("lambda " if ":" in text else "") + text.replace("^", "**"), {"__builtins__": {}} | names)

    @cached_property
    def places(self) -> list[tuple[tuple[int, ...], tuple[str, str, str]]]:
        return list(itertools.product(itertools.product(*map(range, self.cells)), self.sites))

    @cached_property
    def mass(self) -> Array:
        return np.array([self.value(site[2], cell) for cell, site in self.places])

    @cached_property
    def onsite(self) -> list[Callable[..., Any]]:
        return [self.value(f"y: {site[1]}", cell) for cell, site in self.places]

    @cached_property
    def links(self) -> list[tuple[int | None, int | None, Callable[..., Any], float, float]]:
        """Ends, force and gains of all bonds; no index where an end is held."""
        number = {(cell, site[0]): i for i, (cell, site) in enumerate(self.places)}
        found = []
        for (start, end, offset, force, gain), cell, sense in itertools.product(
            self.bonds, itertools.product(*map(range, self.cells)), (1, -1)
        ):
            there = [k + sense * step for k, step in zip(cell, offset, strict=True)]
            there = [k % c if b == "periodic" else k for k, c, b in zip(there, self.cells, self.boundary, strict=True)]
            out = [b for k, c, b in zip(there, self.cells, self.boundary, strict=True) if not 0 <= k < c]
            if "free" in out or (sense == -1 and not out):
                continue
            ends = (number[cell, start], None if out else number[tuple(there), end])
            law = (self.value(f"d: {force}", cell), *(self.value(g, cell) for g in gain))
            found.append((*(ends if sense == 1 else (None, number[cell, end])), *law))
        return found

    def acceleration(self, y: Array) -> Array:
        """y'' at positions of shape (sites, ...), real or complex."""
        forces = np.array([-force(y[i]) + 0 * y[i] for i, force in enumerate(self.onsite)])
        for start, end, force, left, right in self.links:
            f = force((0.0 if end is None else y[end]) - (0.0 if start is None else y[start]))
            if start is not None:
                forces[start] += left * f
            if end is not None:
                forces[end] -= right * f
        return forces / self.mass.reshape(-1, *[1] * (y.ndim - 1))

    def jacobian(self, y: Array) -> Array:
        """Derivative of y'' by positions, shape (sites, sites, ...)."""
        steps = 1j * STEP * np.eye(len(y)).reshape(*[len(y)] * 2, *[1] * (y.ndim - 1))
        return np.stack([self.acceleration(y + step).imag / STEP for step in steps], axis=1)

    def modes(self) -> tuple[Array, Array]:
        """omega^2 ascending and displacements as columns."""
        squares, modes = np.linalg.eig(-self.jacobian(np.zeros(len(self.places))))
        order = np.argsort(squares.real)
        return squares[order], modes[:, order]

    def orbit(self, mode: int, S: float, steps: int = 12, harmonics: int = 24) -> tuple[Array, float]:
        """Amplitudes of cosines, shape (harmonics + 1, sites), and Omega, followed from a mode to a sum of squares S.

        Where the mean of the positions is free it is that of the mode, 0: the step of least size does not move it.
        """
        squares, modes = self.modes()
        direction, k2 = modes[:, mode - 1].real, np.arange(harmonics + 1.0) ** 2
        direction = direction * np.sign(direction[np.argmax(np.abs(direction) > (1 - 1e-9) * np.abs(direction).max())])
        waves = np.cos(np.outer(2 * np.pi * np.arange(4 * harmonics) / (4 * harmonics), np.arange(harmonics + 1)))
        average = waves.T / (2 * harmonics)
        average[0] /= 2
        n, free = len(direction), np.flatnonzero(np.abs(squares) < 1e-10)
        left = np.linalg.inv(modes)[free].real * self.mass.max()  # what of the mean no force changes
        a = np.zeros((harmonics + 1, n))
        a[1] = np.sqrt(S) / steps * direction / np.linalg.norm(direction)
        z, before = np.append(a.ravel(), np.sqrt(squares[mode - 1].real)), None
        for amplitude in np.sqrt(S) * np.linspace(1 / steps, 1, steps):
            z, before = (z if before is None else 2 * z - before), z
            for _ in range(30):
                a, Omega, start = z[:-1].reshape(-1, n), z[-1], z[:-1].reshape(-1, n).sum(axis=0)
                y = (waves @ a).T
                matrix = np.einsum("km,ijm,ml->kilj", average, self.jacobian(y), waves).reshape(a.size, a.size)
                matrix[np.diag_indices(a.size)] += Omega**2 * np.repeat(k2, n)
                matrix = np.column_stack([matrix, (2 * Omega * k2[:, None] * a).ravel()])
                rows = np.vstack(
                    [np.append(np.tile(2 * start, harmonics + 1), 0), np.pad(left, ((0, 0), (0, a.size + 1 - n)))]
                )
                residual = (Omega**2 * k2[:, None] * a + average @ self.acceleration(y).T).ravel()
                residual = np.concatenate([residual, [start @ start - amplitude**2], left @ a[0]])
                step = np.linalg.lstsq(np.vstack([matrix, rows]), -residual, rcond=1e-13)[0]
                z = z + step
                if np.max(np.abs(step)) < 1e-12 * np.max(np.abs(z)):
                    break
            else:
                raise RuntimeError(f"no convergence at S = {amplitude**2}")
        assert np.max(np.abs(z[:-1].reshape(-1, n)[-2:])) < 1e-10 * np.max(np.abs(z))
        return z[:-1].reshape(-1, n), float(z[-1])

    def multipliers(self, y: Array, period: float) -> tuple[Array, Array]:
        """Eigenvalues of the monodromy matrix of an orbit that starts from rest, and their condition numbers."""
        n = len(y)

        def rate(t: float, flat: Array) -> Array:
            z = flat.reshape(2 * n, -1)
            moved = np.column_stack([self.acceleration(z[:n, 0]), self.jacobian(z[:n, 0]) @ z[:n, 1:]])
            return np.vstack([z[n:], moved]).ravel()

        start = np.column_stack([np.append(y, 0 * y), np.eye(2 * n)])
        run = solve_ivp(rate, (0, period), start.ravel(), method="DOP853", rtol=1e-12, atol=1e-14)
        end = run.y[:, -1].reshape(2 * n, -1)
        assert np.max(np.abs(end[:, 0] - start[:, 0])) < 1e-9
        values, right = np.linalg.eig(end[:, 1:])
        return values, np.linalg.norm(right, axis=0) * np.linalg.norm(np.linalg.inv(right), axis=1)

    def energy(self, y: Array) -> float:
        """Of positions at rest, above that of 0, by quadrature of the forces; weights 1 at the site of the least."""
        weights: dict[int, float] = {}
        inner = [(a, b, left / right) for a, b, _, left, right in self.links if a is not None and b is not None]
        for first in range(len(y)):
            part = {} if first in weights else {first: 1.0}
            for _ in y:
                for a, b, ratio in inner:
                    part |= {b: part[a] * ratio} if a in part and b not in part else {}
                    part |= {a: part[b] / ratio} if b in part and a not in part else {}
            weights |= {i: weight / min(part.values()) for i, weight in part.items()}
        total = sum(weights[i] * quad(force, 0, y[i], epsabs=1e-14)[0] for i, force in enumerate(self.onsite))
        for a, b, force, left, right in self.links:
            d = (0.0 if b is None else y[b]) - (0.0 if a is None else y[a])
            total += (weights[b] * right if a is None else weights[a] * left) * quad(force, 0, d, epsabs=1e-14)[0]
        return float(total)
