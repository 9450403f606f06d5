"""Where the product's own files lie: beside the source in a checkout, in the package where a wheel was installed."""

from __future__ import annotations

from pathlib import Path

_CHECKOUT = Path(__file__).resolve().parents[2]
ROOT = _CHECKOUT if (_CHECKOUT / "backend" / "desirepath").is_dir() else Path(__file__).resolve().parent / "files"
FRONTEND, DOCS = ROOT / "frontend", ROOT / "docs"
PROTOCOLS, DATASETS = ROOT / "study_protocols", ROOT / "datasets"
