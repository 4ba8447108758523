"""A run: its session, its folder with checkpoints and curve, and what is shown of it."""
