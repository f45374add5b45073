"""Studies: collections of scenes and what they show together."""
