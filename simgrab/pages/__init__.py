"""The pages of `simgrab browse` and `simgrab studio`, and the server that both use."""
