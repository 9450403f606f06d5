"""The colours: every pairing of the design readable in both schemes (WCAG 2.2: 4.5 for text, 3 for controls)."""

import re
from pathlib import Path

import pytest

TOKENS = (Path(__file__).resolve().parents[2] / "frontend" / "static" / "css" / "tokens.css").read_text()
GROUNDS = ("ground", "raised", "sunken")
TEXT_PAIRS = [(text, ground) for text in ("ink", "ink-soft", "accent-text", "attention", "error") for ground in GROUNDS]
TEXT_PAIRS += [("on-accent", "accent"), ("on-accent", "accent-strong"), ("on-error", "error"), ("ink", "accent-wash")]
TEXT_PAIRS += [("ink", "attention-wash"), ("ink", "error-wash"), ("accent-text", "accent-wash")]
TEXT_PAIRS += [("attention", "attention-wash"), ("error", "error-wash")]
CONTROL_PAIRS = [(edge, ground) for edge in ("edge", "accent", "focus") for ground in GROUNDS]
CONTROL_PAIRS += [(f"data-{i}", ground) for i in range(1, 6) for ground in ("ground", "raised")]


def scheme(name: str) -> dict[str, tuple[int, int, int]]:
    """The hexadecimal colours of one scheme; the dark one overrides the light one."""
    light, dark = TOKENS.split("@media (prefers-color-scheme: dark)")
    found = re.findall(r"--([a-z0-9-]+):\s*#([0-9a-f]{6})", light + (dark if name == "dark" else ""))
    return {token: (int(code[:2], 16), int(code[2:4], 16), int(code[4:], 16)) for token, code in found}


def luminance(colour: tuple[int, int, int]) -> float:
    """Relative luminance as WCAG defines it."""
    linear = [c / 255 / 12.92 if c / 255 <= 0.04045 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
    brighter, darker = sorted((luminance(one), luminance(other)), reverse=True)
    return (brighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("name", ["light", "dark"])
@pytest.mark.parametrize(("pairs", "least"), [(TEXT_PAIRS, 4.5), (CONTROL_PAIRS, 3.0)], ids=["text", "controls"])
def test_every_pairing_is_readable(name: str, pairs: list[tuple[str, str]], least: float) -> None:
    colours = scheme(name)
    weak = {f"{a} on {b}": round(contrast(colours[a], colours[b]), 2) for a, b in pairs}
    assert {pair: ratio for pair, ratio in weak.items() if ratio < least} == {}
