"""Orbits and solutions, their branches and changes of stability, with the solvers and continuations."""
