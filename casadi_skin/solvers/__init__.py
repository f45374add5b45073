"""Solvers: Newton, Ipopt, the bordered linear solver, levels of resolution."""
