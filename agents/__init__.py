"""The robot: maps, sensing, fusion, planning, sharing, and the life that ties them."""
