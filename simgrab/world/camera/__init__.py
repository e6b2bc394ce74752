"""What the camera makes of a scene: renderer, shutter, weather, lens, sensor and display."""
