"""Makes the frames and their truth."""

from simgrab.world import gl

gl.choose()  # must come before mujoco is imported anywhere below
