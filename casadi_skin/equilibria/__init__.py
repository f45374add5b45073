"""Equilibria of any model: solved, followed in a parameter, with special points and the branches that leave there."""
