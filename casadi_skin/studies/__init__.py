"""Studies: collections of scenes and their joint results."""
