"""Food and water: particles in a container, and what they touch."""
