"""A campaign of faults against the running graph: ``python -m benchmarks.faults --help``."""
