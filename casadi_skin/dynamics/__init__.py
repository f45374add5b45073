"""Time evolution of any model, from any start or near an orbit."""

from casadi_skin.dynamics.evolution import EquationsOfMotion, Evolution, EvolutionError, equations_of_motion
from casadi_skin.dynamics.evolve import distance_from_orbit, evolve, perturbed, simulate_orbit

__all__ = [
    "EquationsOfMotion",
    "Evolution",
    "EvolutionError",
    "distance_from_orbit",
    "equations_of_motion",
    "evolve",
    "perturbed",
    "simulate_orbit",
]
