"""Torch faces of the kernels, same file names."""
