"""A renderer of silhouettes that shares nothing with MuJoCo's but the shapes: pyrender, or ray casting with Embree."""

from simgrab.judge.audit.second_renderer.choice import RENDERERS, install_hint, open_second_renderer
from simgrab.judge.audit.second_renderer.interface import SecondRenderer, Shapes

__all__ = ["RENDERERS", "SecondRenderer", "Shapes", "install_hint", "open_second_renderer"]
