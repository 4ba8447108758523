"""Food and water: particles in a vessel."""
