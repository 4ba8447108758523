"""Evaluation of policies: running episodes, scores and statistics."""
