"""Measures from frames alone, without truth, scenes or the renderer."""
