"""A renderer of silhouettes that shares nothing with MuJoCo's but the shapes: pyrender, or ray casting with Embree."""

from simgrab.judge.audit.second_renderer.choice import RENDERERS, OpenedRenderer, install_hint, open_second_renderer
from simgrab.judge.audit.second_renderer.interface import SecondRenderer, Shapes

__all__ = ["RENDERERS", "OpenedRenderer", "SecondRenderer", "Shapes", "install_hint", "open_second_renderer"]
