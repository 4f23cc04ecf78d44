"""Kernels selected by the depth, or by depth and direction, of the output."""
