"""Models as data: `OdeModel`, formulas, symmetries, models in files."""
