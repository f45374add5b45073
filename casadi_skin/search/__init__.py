"""Orbits and perturbations found by optimisation."""
