"""Runs: from a video to angles and alarms."""
