"""Write the bundled textures into assets/textures: `python -m scripts.make_textures`, from the repository's root."""

from __future__ import annotations

from pathlib import Path

from scripts.textures import ground, steel

FOLDER = Path(__file__).resolve().parents[1] / "assets" / "textures"

if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    ground.write_all(FOLDER)
    steel.write_all(FOLDER)
