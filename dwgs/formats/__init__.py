"""Gaussians, assets and backgrounds on disk, in files that other tools read. NumPy only."""
