"""What plug-ins of other packages bring to the pages: their texts, and a kind of step's template and ES module.

They lie beside the plug-in's module under its name: `note.en.yaml`, `note.html`, `note.js`. Nothing else of a package
is read or served, and nothing of the product's is replaced.
"""

from __future__ import annotations

from pathlib import Path

from jinja2 import BaseLoader, ChoiceLoader, FunctionLoader

from desirepath.grammar.source import file_text
from desirepath.jobs.alignment import REGISTRY as ALIGNMENTS
from desirepath.learning.queries.choosing import STRATEGIES
from desirepath.learning.rewards.kinds import FITTINGS
from desirepath.study.kind import KINDS

REGISTRIES = (KINDS, STRATEGIES, FITTINGS, ALIGNMENTS)
STEPS = "participant/steps/"


def text_files(language: str) -> list[Path]:
    """Their texts in that language, each file with the catalogues' names as its first keys."""
    return [file for registry in REGISTRIES for file in registry.beside(f".{language}.yaml").values()]


def scripts() -> dict[str, Path]:
    """Kind of step -> its ES module."""
    return KINDS.beside(".js")


def with_step_templates(product: BaseLoader) -> BaseLoader:
    """The product's templates, and behind them those of kinds of step."""
    pages = {f"{STEPS}{name}.html": file for name, file in KINDS.beside(".html").items()}
    return ChoiceLoader([product, FunctionLoader(lambda name: file_text(pages[name]) if name in pages else None)])
