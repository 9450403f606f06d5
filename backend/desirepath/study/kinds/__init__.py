"""The kinds of step, one file each, found by looking (`study/kind.py`)."""
