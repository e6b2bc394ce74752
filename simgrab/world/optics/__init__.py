"""From light to the picture that a surveillance camera gives."""
