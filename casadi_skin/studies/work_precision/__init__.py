"""The cost of accuracy, method by method."""
