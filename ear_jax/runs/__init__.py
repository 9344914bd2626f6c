"""A training run: its compiled program, the host loop and its files on disk."""
