"""Files as they are written and read: replaced whole, and checked against checksums. Imports no JAX."""
