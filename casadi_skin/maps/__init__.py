"""Maps: a scene over one or two of its parameters, on one machine or many."""
