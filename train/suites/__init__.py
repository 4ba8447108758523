"""Trainings of many environments as processes: what is to be done, who runs it, and how far the whole is."""
