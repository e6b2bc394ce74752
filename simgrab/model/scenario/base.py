"""What every table of a scenario is made of."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from simgrab.io.strict import Checked

Meta = msgspec.Meta
Share = Annotated[float, Meta(ge=0, le=1)]
Cargo = Literal["coal", "ore", "grain", "bauxite", "sulphur"]


class Strict(Checked, frozen=True):
    """Base of every table."""


class Tagged(Strict, frozen=True, tag_field="model"):
    """Base of every table that comes in kinds, distinguished by ``model``."""
