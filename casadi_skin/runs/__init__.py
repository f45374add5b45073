"""Runs of scenes, of chains and of any model: planned, computed and written."""
