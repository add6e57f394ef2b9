"""What a map of elevations tells beyond its cells: unknown ones completed, slopes, edges, ways."""
