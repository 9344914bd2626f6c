"""Figures, strips, films and pages, drawn from documents and poses; imports no JAX."""
