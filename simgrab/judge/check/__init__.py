"""A gate for CI: render, measure, evaluate, and compare with limits and with a recorded baseline."""
