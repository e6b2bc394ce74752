"""Datasets, videos and shards of labelled frames: written, read, exported. The instrument may not import this room."""
