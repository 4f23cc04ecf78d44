"""Kernels chosen by the depth, or the depth and direction, that the output was in."""
