"""The main job: every method and engine over the scenes, judged and timed."""
