"""Families of nonlinear modes of a chain: what is asked for, the walk with stability beside it, the results."""
