"""Processes, machines, versions and the environment that everything else runs in."""
