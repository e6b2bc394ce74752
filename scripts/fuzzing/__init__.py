"""Parts of `scripts.fuzz`: seed files, generators of hostile files, what opens them, and processes that do so."""
