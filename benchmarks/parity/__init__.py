"""How near this package is to Assistive Gym v0.1: one module for each subject, each with a function ``rows``."""
