"""Newton's method, Ipopt, bordered linear solvers, resolutions and their error estimates, first solutions."""
