"""The judge: it compares what was measured with what is known."""
