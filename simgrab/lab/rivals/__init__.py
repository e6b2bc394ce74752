"""Methods of the literature, after their sources, measured on the same swings as simgrab's own."""
