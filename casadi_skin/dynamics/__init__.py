"""Time evolution of any model, from any start or near an orbit."""
