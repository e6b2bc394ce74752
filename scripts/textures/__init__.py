"""Makers of the bundled textures; run them all with ``scripts/make_textures.py``."""
