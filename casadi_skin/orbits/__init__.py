"""Orbits and solutions, their branches, changes of stability; what finds and follows them."""
