"""Correctors: a problem, a guess and one held condition in; a converged point or a named failure out."""
