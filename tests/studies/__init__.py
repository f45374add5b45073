"""Studies of the whole program: whether its error estimates are honest, and where it holds at the extremes."""
