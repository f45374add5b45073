"""Boundary-value problems of periodic orbits: symmetry classes, transcriptions, the orbit."""
