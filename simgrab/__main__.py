"""``python -m simgrab``."""

from simgrab.cli import main

main()
