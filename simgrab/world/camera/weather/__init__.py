"""Weather between the rendered scene and the camera, with true depth: a known amount of each, and labels unmoved."""

from simgrab.world.camera.weather.chain import Weathered, apply, hidden_fraction
from simgrab.world.camera.weather.ground import Lamp
from simgrab.world.camera.weather.render_pass import RenderPass
from simgrab.world.camera.weather.still import Still

__all__ = ["Lamp", "RenderPass", "Still", "Weathered", "apply", "hidden_fraction"]
