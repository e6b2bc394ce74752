"""A gate for CI: render, measure, evaluate, and compare with what is accepted and with what was recorded."""
