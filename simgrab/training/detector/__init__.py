"""The bundled detector: nets that find the grab in the whole picture, refine where it is, and settle that it is it."""
