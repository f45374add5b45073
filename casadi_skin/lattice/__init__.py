"""The nonreciprocal chain: model, coordinates, linear modes; full chain, edge site, core with a linear tail."""
