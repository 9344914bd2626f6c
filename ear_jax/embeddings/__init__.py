"""Analyses of a trained policy's task embeddings: evaluation, blending, search and maps."""
