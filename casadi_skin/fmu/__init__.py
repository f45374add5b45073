"""Functional Mock-up Units (FMI 3.0 and 2.0) of chains and models, out and in; see https://fmi-standard.org."""
