"""Cut the display's font out of WenQuanYi Micro Hei: `scripts/python -m scripts.make_font [wqy-microhei.ttc]`.

The collection comes with Debian's fonts-wqy-microhei. Needs fontTools, which matplotlib brings.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fontTools.subset import Options, Subsetter
from fontTools.ttLib import TTFont

INSTALLED = Path("/usr/share/fonts/truetype/wqy/wqy-microhei.ttc")
FONT = Path(__file__).resolve().parents[1] / "assets" / "fonts" / "wqy-microhei-osd.ttf"
CHARACTERS = "0123456789:. 年月日星期一二三四五六"


def cut(collection: Path, target: Path) -> None:
    """Write the first font of a collection with no more than the display's characters in it."""
    font = TTFont(collection, fontNumber=0, recalcTimestamp=False)  # the same bytes each run
    options = Options()
    options.hinting = False  # glyphs are drawn large and averaged, so hints would only differ between FreeTypes
    options.layout_features = []
    options.name_IDs = ["*"]  # copyright and licence stay in the file
    options.name_languages = [0x409]
    options.drop_tables += ["FFTM", "vhea", "vmtx"]
    subsetter = Subsetter(options)
    subsetter.populate(text=CHARACTERS)
    subsetter.subset(font)
    font.save(target)


if __name__ == "__main__":
    cut(Path(sys.argv[1]) if len(sys.argv) > 1 else INSTALLED, FONT)
