"""Names of the numbers that a search may free and of the quantities that it may optimise or bound; without numerics."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

NAMED: Mapping[str, str] = MappingProxyType(
    {
        "S": "total amplitude, the sum of y_n^2 at the phase where all velocities vanish",
        "Omega": "frequency",
        "period": "2 pi/Omega",
        "energy": "Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to",
        "participation": "participation ratio (sum of y_n^2)^2 / sum of y_n^4 at that phase, from 1 to N",
        "Omega_slope": "dOmega/dS along the family, at fixed parameters",
        "energy_slope": "d(energy)/dS along the family, at fixed parameters",
        "gamma": "nonreciprocity",
        "alpha": "on-site stiffness; its mean where every site has one of its own",
        "g": "cubic on-site coefficient",
        "upper_cutoff": "upper cutoff sqrt(2 + alpha + 2 s) of the infinite chain",
        "lower_cutoff": "lower cutoff sqrt(2 + alpha - 2 s) of the infinite chain",
        "above_band": "Omega - upper_cutoff",
        "below_band": "lower_cutoff - Omega",
        "amplification": "r^((N-1)/2), the scale of the amplification of a kick at the far end",
        "log_amplification": "natural logarithm of amplification",
        "roughness": "sum of (alpha_{n+1} - alpha_n)^2",
    }
)
FREE: Mapping[str, str] = MappingProxyType(
    {
        "S": "total amplitude",
        "gamma": "nonreciprocity",
        "alpha": "on-site stiffness, the same at every site",
        "g": "cubic on-site coefficient",
        "alpha_n": "on-site stiffness, one a site",
    }
)
