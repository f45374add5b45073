"""Functional Mock-up Units (FMI 3.0 and 2.0) of chains and models; see https://fmi-standard.org."""

from casadi_skin.export.fmu.archive import export_fmu

__all__ = ["export_fmu"]
