"""Measuring policies: episodes, scores and who acts."""
