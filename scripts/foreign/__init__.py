"""Parts of `scripts.foreign_exam`: pictures of simgrab's scenes that simgrab did not draw."""
