"""Orbits found by optimisation, boundary-value problems with an objective, the smallest kick."""
