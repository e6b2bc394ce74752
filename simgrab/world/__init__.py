"""The world: it makes the frames and the truth."""

from simgrab.world import gl

gl.choose()  # must come before mujoco is imported anywhere below
