"""Put a vehicle into a recorded drive, and take it home as 3D Gaussians."""

__version__ = "0.1.0"
