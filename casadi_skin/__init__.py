"""Nonlinear periodic orbits in nonreciprocal lattices: families, stability, and a continuation toolkit on CasADi."""

from casadi_skin._version import __version__
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.families.branch import Branch
from casadi_skin.families.follow import follow_family
from casadi_skin.families.orbit import Orbit
from casadi_skin.models.chain import Chain
from casadi_skin.models.ode import OdeModel

__all__ = ["Branch", "Chain", "OdeModel", "Orbit", "SymmetryClass", "__version__", "follow_family"]
