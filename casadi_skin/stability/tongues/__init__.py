"""Every change of stability along a family: multipliers as functions of S, between places where they are certain."""
