"""Weather between the rendered scene and the camera, with true depth: a known amount of each, and labels unmoved."""

from simgrab.world.camera.weather.chain import Weathered, apply, hidden_fraction
from simgrab.world.camera.weather.ground import Lamp
from simgrab.world.camera.weather.render_pass import RenderPass

__all__ = ["Lamp", "RenderPass", "Weathered", "apply", "hidden_fraction"]
