"""Equilibria of any model: found, followed in a parameter, with their special points and what leaves there."""
