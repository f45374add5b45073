"""Floquet stability: flow maps of the variational system, multipliers, vectors, kinds of instability."""
