"""Kernels in C, compiled at first use where there is a compiler; numpy does the same where there is none."""
