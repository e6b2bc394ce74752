# /// script
# requires-python = ">=3.11"
# dependencies = ["libreyolo==1.6.0", "torch", "opencv-python", "onnx", "onnxscript", "onnxruntime"]
# ///
"""Train a YOLOX on an unconverted dataset, and export it: ``uv run scripts/train_yolo.py DATASET --out yolox.onnx``.

Runs in an environment of its own, which uv makes from the lines above: libreyolo (MIT) needs ``opencv-python``, whose
files lie where simgrab's ``opencv-python-headless`` has its own. ``simgrab detect PICTURES --detector yolox.onnx`` and
``python -m scripts.score_detector DATASET --detector yolox.onnx`` take what comes out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from libreyolo import LibreYOLOX  # type: ignore[import-not-found]


def main() -> None:
    """Train and export."""
    parser = argparse.ArgumentParser(description="Train a YOLOX on a dataset as it lies, and export it.")
    parser.add_argument("dataset", type=Path, help="as simgrab render wrote it")
    parser.add_argument("--out", type=Path, default=Path("runs/yolox.onnx"))
    parser.add_argument("--size", default="n", choices=["n", "t", "s", "m", "l", "x"])
    parser.add_argument("--epochs", type=int, default=40)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--px", type=int, default=416, help="side of its pictures")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted training")
    parser.add_argument("--ram", action="store_true", help="keep shrunken pictures in memory, 0.3 MB each at 416 px")
    options = parser.parse_args()
    runs = options.out.parent / f"{options.out.stem}-training"

    # Lists of pictures: from folders it would validate by COCO's files, whose file_name it takes for a bare name.
    runs.mkdir(parents=True, exist_ok=True)
    for split in ("train", "val"):
        pictures = sorted((options.dataset / "images" / split).resolve().iterdir())
        (runs / f"{split}.txt").write_text("".join(f"{picture}\n" for picture in pictures))
    lists = f"train: {(runs / 'train.txt').resolve()}\nval: {(runs / 'val.txt').resolve()}\n"
    (runs / "data.yaml").write_text(f"{lists}nc: 1\nnames: [grab]\n")

    weights = (runs / "yolox" / "weights").resolve()
    resumed = options.resume and (weights / "last.pt").exists()
    # No model path: begins from chance, and needs no network.
    net = LibreYOLOX(str(weights / "last.pt") if resumed else None, size=options.size, nb_classes=1)
    net.model.to(memory_format=torch.channels_last)  # takes two thirds of the time on CPUs
    # Mosaics and turned pictures teach boxes that are not tight.
    results = net.train(
        data=str(runs / "data.yaml"), epochs=options.epochs, batch=options.batch, imgsz=options.px,
        seed=options.seed, project=str(runs), name="yolox", exist_ok=True, workers=2, patience=0,
        cache=options.ram, mosaic_prob=0.0, mixup_prob=0.0, degrees=0.0,
        **({"resume": True} if resumed else {"pretrained": False}),
    )  # fmt: skip
    trained = LibreYOLOX(str(weights / "best.pt"), size=options.size, nb_classes=1)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    trained.export("onnx", output_path=str(options.out), imgsz=options.px, simplify=False)
    print(f"{options.out}: best mAP50-95 on validation frames {results.get('best_mAP50_95')}")


if __name__ == "__main__":
    main()
