"""Making the shipped artefacts, each with the card that says how; finding them lives in `learning/policies/shipped.py`."""
