"""Documents describe every room: where one has been deleted, they are not tested."""

import importlib.util

from scripts.without_room import ROOMS

collect_ignore_glob = [] if all(importlib.util.find_spec(f"simgrab.{room}") for room in ROOMS) else ["test_*.py"]
