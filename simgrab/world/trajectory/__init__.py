"""Motion: independent draws, or the grab as a pendulum below a crane that works in the wind."""
