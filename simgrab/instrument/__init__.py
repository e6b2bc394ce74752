"""What measures from frames alone: it never sees truth, scenes or the renderer."""
