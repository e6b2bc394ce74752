"""The nets of the detector: one proposes boxes in the whole picture, the other predicts presence and pose in crops."""
