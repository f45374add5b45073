"""Squared linear frequencies of the chain one by one, as `theory.linear` has them in arrays; this loads no numerics."""

from __future__ import annotations

import math


def stiffness(sites: float, gamma: float, mode: int) -> float:
    """omega_j^2 - alpha of a chain, of an infinite one that of a limit of its band.

    Arguments:
        sites: their number, or inf.
        gamma: nonreciprocity, between -1 and 1.
        mode: j, from 1 to `sites`; in an infinite chain 1 is the lower limit, any other number the upper one.

    Returns:
        2 - 2 s cos(j pi/(N + 1)) with s = sqrt(1 - gamma^2), without subtracting equal numbers.
    """
    s = math.sqrt((1 - gamma) * (1 + gamma))
    if sites == math.inf:
        return 2 * gamma**2 / (1 + s) + (0.0 if mode == 1 else 4 * s)
    # 1 - s = gamma^2/(1 + s), 1 - cos(q) = 2 sin^2(q/2)
    return 2 * gamma**2 / (1 + s) + 4 * s * math.sin(mode * math.pi / (2 * sites + 2)) ** 2
