"""Experiments, benchmarks and fault tests of a society, and generators of the documentation."""
