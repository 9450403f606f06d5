"""Making the shipped artefacts, each with a card that says how. Finding them: `learning/shipped_files.py`."""
