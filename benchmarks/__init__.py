"""Measurements: `python -m benchmarks run WORKLOAD`."""
