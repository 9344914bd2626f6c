"""Benchmarks: `python -m benchmarks.NAME [--quick]` prints JSON rows and appends them to `results/`."""
