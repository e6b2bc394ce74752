"""SwingBench: methods that measure swing, on the same clips, by the same scorer."""
