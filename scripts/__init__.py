"""Asset builders and measurements, run from the repository root."""
