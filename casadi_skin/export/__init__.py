"""Models out of Python: C code and FMUs."""
