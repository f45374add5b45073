"""The smallest kick that takes a breather away."""
