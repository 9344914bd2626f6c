"""One script a question: `python -m benchmarks.NAME [--quick]` prints JSON rows and keeps them in `results/`."""
