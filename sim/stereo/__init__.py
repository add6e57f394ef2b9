"""Images of the world: terrain, robots and a landmark as a pair of cameras sees them."""
