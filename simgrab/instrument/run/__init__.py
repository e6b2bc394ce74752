"""From a video to angles and alarms."""
