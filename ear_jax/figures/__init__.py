"""From records to tables and figures. Nothing here trains, and nothing imports JAX."""
