"""Matter beside MJX: food and water as position-based particles in plain JAX."""
