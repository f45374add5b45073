"""Folds, period doublings and tori of orbits: located, followed in two parameters, with their normal forms."""
