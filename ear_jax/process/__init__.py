"""How this process runs: JAX's options, the terminal, signals, and imports that print."""
