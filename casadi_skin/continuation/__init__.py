"""Continuation of any problem with one more unknown than equations."""
