"""Time evolution of any model."""

from casadi_skin.dynamics.evolution import (
    LONGEST_ENVELOPE,
    METHODS,
    Evolution,
    EvolutionError,
    distance_from_orbit,
    evolve,
    perturbed,
    simulate_orbit,
)

__all__ = [
    "LONGEST_ENVELOPE",
    "METHODS",
    "Evolution",
    "EvolutionError",
    "distance_from_orbit",
    "evolve",
    "perturbed",
    "simulate_orbit",
]
