"""Models whose cycle is the unit circle and whose multipliers are exp(2 pi f(l)), with f the rates of its surroundings.

x' = x (1 - s) - y, y' = y (1 - s) + x with s = x^2 + y^2 has the cycle s = 1 with the multiplier exp(-4 pi); beside it
stand linear blocks: w' = f(l) w, and u' = f(l) u - h v, v' = h u + f(l) v, which turns by 2 pi h a period. All are seen
through a linear change of coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin import OdeModel, find_orbit


@dataclass(frozen=True)
class Block:
    """A block: coefficients of f(l), lowest first, and its turn h, 0 of a real one."""

    rate: tuple[float, ...]
    turn: float = 0.0

    @property
    def size(self) -> int:
        return 2 if self.turn else 1

    def at(self, value: float) -> float:
        return float(np.polynomial.polynomial.polyval(value, self.rate))

    def roots(self) -> list[float]:
        """Where f vanishes between 0 and 1."""
        found = np.roots(self.rate[::-1])
        real = found.real[np.abs(found.imag) < 1e-12]
        return sorted(float(value) for value in real if 0.0 < value < 1.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """A model by its blocks and the change of coordinates, shape (n, n)."""

    blocks: tuple[Block, ...]
    seen: np.ndarray | None = None

    @property
    def model(self) -> OdeModel:
        n = 2 + sum(block.size for block in self.blocks)
        state = ca.vertcat(*(ca.SX.sym(f"x{k}") for k in range(n)))
        value = ca.SX.sym("l")
        own = state if self.seen is None else ca.mtimes(ca.DM(np.linalg.inv(self.seen)), state)
        square = own[0] ** 2 + own[1] ** 2
        rates = [own[0] * (1 - square) - own[1], own[1] * (1 - square) + own[0]]
        for block in self.blocks:
            k = len(rates)
            growth = sum(c * value**i for i, c in enumerate(block.rate))
            if block.turn:
                rates += [growth * own[k] - block.turn * own[k + 1], block.turn * own[k] + growth * own[k + 1]]
            else:
                rates += [growth * own[k]]
        rhs = ca.vertcat(*rates)
        return OdeModel("truth", state, rhs if self.seen is None else ca.mtimes(ca.DM(self.seen), rhs), value)

    def follow(self, **options: object) -> object:
        """The branch from l = 0 to 1 with its stability."""
        model = self.model

        def circle(t: float) -> np.ndarray:
            own = np.zeros(model.full_size)
            own[:2] = np.cos(t), np.sin(t)
            return own if self.seen is None else self.seen @ own

        orbit = find_orbit(model, circle, 2.0 * np.pi, parameters={"l": 0.0})
        return orbit.follow("l", 1.0, stability=True, **options)

    @property
    def events(self) -> list[tuple[float, str]]:
        """Places and kinds of the special points, in order."""
        kinds = [(place, "torus" if block.turn else "branch point") for block in self.blocks for place in block.roots()]
        return sorted(kinds)

    def outside(self, value: float) -> int:
        """The number of multipliers outside the unit circle."""
        return sum(block.size for block in self.blocks if block.at(value) > 0.0)

    @property
    def changes(self) -> list[float]:
        """Places of the changes of stability."""
        beside = 1e-9
        return [
            place
            for place, _ in self.events
            if (self.outside(place - beside) == 0) != (self.outside(place + beside) == 0)
        ]


def random_truth(seed: int, units: float = 0.0) -> Truth:
    """One to three blocks, of which some have two roots near to each other, in units of 10^-units to 10^units."""
    generator = np.random.default_rng(seed)
    roots: Callable[..., np.ndarray] = np.polynomial.polynomial.polyfromroots
    blocks = []
    for _ in range(generator.integers(1, 4)):
        turn = float(generator.uniform(0.1, 0.9)) if generator.random() < 0.7 else 0.0
        if generator.random() < 0.3:
            middle, width = generator.uniform(0.1, 0.9), 10.0 ** generator.uniform(-2.5, -1.0)
            rate = roots([middle - 0.5 * width, middle + 0.5 * width]) * generator.uniform(0.2, 1.0)
        else:
            rate = roots(generator.uniform(-0.5, 1.5, generator.integers(1, 4))) * generator.uniform(0.05, 0.5)
        blocks.append(Block(tuple((rate * generator.choice([-1.0, 1.0])).tolist()), turn))
    n = 2 + sum(block.size for block in blocks)
    seen = np.linalg.qr(generator.normal(size=(n, n)))[0] * 10.0 ** generator.uniform(-0.5, 0.5, n)
    return Truth(tuple(blocks), 10.0 ** generator.uniform(-units, units, n)[:, None] * seen)
