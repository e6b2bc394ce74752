"""The second renderers that this machine can have, as parameters of tests."""

import pytest

from simgrab.judge.audit.second_renderer.choice import embree_has_wheels
from simgrab.judge.audit.second_renderer.embree_rays import EmbreeRays
from simgrab.judge.audit.second_renderer.pyrender_process import PyrenderProcess

needs_embree = pytest.mark.skipif(not embree_has_wheels(), reason="embreex has no wheels for this machine")
SECOND_RENDERERS = [
    pytest.param(PyrenderProcess, id="pyrender"),
    pytest.param(EmbreeRays, id="embreex", marks=needs_embree),
]
