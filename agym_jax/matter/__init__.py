"""Matter that MuJoCo does not simulate: food and water as particles, gowns as cloth (XPBD beside MJX)."""
