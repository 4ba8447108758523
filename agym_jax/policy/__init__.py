"""Policies: load a shipped or trained one and run it."""
