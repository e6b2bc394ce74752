"""The bundled detector: a net that finds the grab in the whole picture, and one that refines where it is."""
