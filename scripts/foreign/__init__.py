"""Parts of `scripts.foreign_exam`: pictures of simgrab's scenes that are not rendered by simgrab."""
