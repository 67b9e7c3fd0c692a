"""Known data sets as scene sources."""
