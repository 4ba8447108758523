"""Repairs of other packages; each says for which versions, can be switched off, and has a test that fails once it can go."""
