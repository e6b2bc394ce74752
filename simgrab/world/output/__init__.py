"""What is written: datasets, videos and their tables."""
