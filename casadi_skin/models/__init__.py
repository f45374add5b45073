"""Models: the general door `OdeModel`, and the nonreciprocal chain that goes through it."""
