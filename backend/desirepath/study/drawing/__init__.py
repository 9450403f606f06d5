"""Drawn paths: strokes coming in, what was kept, walks beside them. The kind of step: `kinds/demonstration.py`."""
