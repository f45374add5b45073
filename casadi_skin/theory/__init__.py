"""Closed forms: the linear spectrum, the multiple-scale expansion, and the Duffing oscillator."""
