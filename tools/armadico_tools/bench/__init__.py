"""Benchmarks of a society, beside the bare mesh."""
