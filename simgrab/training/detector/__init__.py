"""The nets of the detector: they find the grab in the whole picture, refine its box, and predict pose and presence."""
