"""Measurements of the product against its peers; see ``python -m benchmarks.matching --help``."""
