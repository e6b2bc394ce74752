"""Write the bundled textures into assets/textures: `python scripts/make_textures.py`."""

from __future__ import annotations

from pathlib import Path

from textures import ground, steel

FOLDER = Path(__file__).resolve().parents[1] / "assets" / "textures"

if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    ground.write_all(FOLDER)
    steel.write_all(FOLDER)
