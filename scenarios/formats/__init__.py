"""Files of maps and of stereo images: ours, and those of others."""
