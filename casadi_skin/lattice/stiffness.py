"""Squared linear frequencies of the chain one by one, and which modes have families; this loads no numerics."""

from __future__ import annotations

import math

NARROWEST_BAND = 1e-10  # of its squared frequency, in which doubles distinguish modes; measured


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


def square_of_family(sites: float, alpha: float, gamma: float, g: float, mode: int) -> float:
    """omega_j^2 of a mode from which a family grows; raises ValueError, naming the argument, where none does.

    Arguments as in `stiffness`, with the on-site stiffness `alpha` and the cubic coefficient `g`.
    """
    if g == 0:
        accepted = "for families a finite number other than 0 (they would be the linear mode at every amplitude)"
        raise ValueError(f"g: given {g!r}; accepted: {accepted}")
    edge, own, coupling = sites if g > 0 else 1, stiffness(sites, gamma, mode), math.sqrt((1 - gamma) * (1 + gamma))
    if abs(gamma) == 1 and mode != edge:
        reason = "at |gamma| = 1 all frequencies meet and only mode N (g > 0) or mode 1 (g < 0), in which the edge"
        accepted = f"mode {edge} ({reason} site alone moves, can be followed)"
        raise ValueError(f"mode: given mode {mode} with gamma = {gamma!r}; accepted: {accepted}")
    square = alpha + own
    if square <= 0:
        given = f"mode {mode}, which has omega^2 = {square:.6g} at alpha = {alpha!r}"
        raise ValueError(f"mode: given {given}; accepted: modes with omega^2 > 0; for mode {mode}: alpha > {-own:.12g}")
    if sites > 1 and 0 < 4 * coupling < NARROWEST_BAND * square:
        most, reason = (
            4 * coupling / NARROWEST_BAND,
            "beside a larger one the modes of the band are the same in doubles",
        )
        raise ValueError(f"alpha: given {alpha!r}; accepted: for families up to {most:.3g} ({reason})")
    return square
