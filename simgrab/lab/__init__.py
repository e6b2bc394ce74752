"""The laboratory: stress studies, the paper, SwingBench, rival methods, and further sensors."""
