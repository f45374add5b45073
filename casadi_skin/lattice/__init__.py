"""The nonreciprocal chain: model, coordinates, linear modes; full chain, edge site, core with a linear tail."""

from casadi_skin.lattice import closed_forms as closed_forms
