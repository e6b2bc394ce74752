"""The page of `simgrab studio`: a scene as controls beside its frames."""
