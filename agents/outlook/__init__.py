"""Ways to choose where to look at the ground, beside the paper's rating: rasters, a line, ours."""
