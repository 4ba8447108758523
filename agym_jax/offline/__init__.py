"""What builds the packaged assets: start placements, postures, settled matter, garments. Not needed to step."""
