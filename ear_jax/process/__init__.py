"""The process: JAX's options, the terminal, signals, and imports that print."""
