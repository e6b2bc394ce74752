"""A page over a finished folder, of a dataset or of a run: what `simgrab browse` does."""
