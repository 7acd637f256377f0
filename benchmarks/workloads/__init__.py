"""One file per workload; each has ``run(frames) -> list[Metric]``."""
