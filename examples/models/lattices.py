"""Lattices as models of one's own: FPUT-beta and a chain of pendula, both with fixed ends."""

import casadi as ca

from casadi_skin import OdeModel


def lattice(name, sites, potential, parameters, nominal):
    """N coupled oscillators y'' = -dV/dy whose potential energy V is even, between walls at rest."""
    y, v = ca.SX.sym("y", sites), ca.SX.sym("v", sites)
    energy = potential(y, ca.diff(ca.vertcat(0, y, 0)))
    return OdeModel(
        name, y, -ca.gradient(energy, y), parameters, 2, v, nominal=nominal,
        reversal=(1,) * sites + (-1,) * sites, half_period=(-1,) * (2 * sites),
        hamiltonian=ca.dot(v, v) / 2 + energy,
    )  # fmt: skip


def fput(sites=24):
    """Fermi, Pasta, Ulam and Tsingou's lattice: bonds with the force d + beta d^3 of their extension d."""
    beta = ca.SX.sym("beta")
    return lattice("FPUT", sites, lambda y, d: ca.sum1(d**2 / 2 + beta * d**4 / 4), beta, (1.0,))


def pendula(sites=16):
    """Pendula that linear springs of stiffness k couple: not polynomial."""
    k = ca.SX.sym("k")
    return lattice("pendula", sites, lambda y, d: ca.sum1(1 - ca.cos(y)) + k * ca.sum1(d**2) / 2, k, (0.2,))
