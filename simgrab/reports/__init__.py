"""Pages, plots and tables of a terminal."""
