"""The paper's tables and figures beside ours, made from the committed records alone. Imports no JAX."""
