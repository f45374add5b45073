"""Boundary-value problems stated in a script: two-point and integral conditions, free parameters, objectives."""
