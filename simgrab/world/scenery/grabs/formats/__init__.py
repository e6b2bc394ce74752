"""Files of 3-D models, each read by its format's standard into the same shapes."""
