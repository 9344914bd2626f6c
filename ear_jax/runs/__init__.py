"""A training run: what is compiled, the host loop around it, and everything it leaves on the disk."""
