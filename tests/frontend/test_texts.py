"""The catalogues: the same texts in every language, and sentences made from them."""

import re
from datetime import UTC, date, datetime
from pathlib import Path

import pytest

from desirepath.cli.serve import DEMO_NAME
from desirepath.installed import PROTOCOLS
from desirepath.web.core.artefact_names import artefact_name, study_name
from desirepath.web.core.catalogues import TextError, Texts, flatten, placeholders

FRONTEND = Path(__file__).resolve().parents[2] / "frontend"
FILES = sorted(file.name for file in (FRONTEND / "locales" / "en").glob("*.yaml"))
CALL = re.compile(r"""\bt\(\s*["']([a-z0-9_.]+)["']\s*[,)]""")
SAID = re.compile(r"""\b(?:say|hint)\(([^()]*)\)""")
KEY = re.compile(r"""["']([a-z][a-z0-9_.]+)["']""")


@pytest.fixture(scope="module")
def texts() -> Texts:
    return Texts(FRONTEND / "locales")


def test_every_language_has_the_same_files(texts: Texts) -> None:
    assert texts.languages == ("de", "en")
    for language in texts.languages:
        assert sorted(file.name for file in (FRONTEND / "locales" / language).glob("*.yaml")) == FILES


@pytest.mark.parametrize("name", [file.removesuffix(".yaml") for file in FILES])
def test_every_language_has_the_same_keys_and_placeholders(texts: Texts, name: str) -> None:
    english = dict(flatten(texts.get("en").table(name)))
    german = dict(flatten(texts.get("de").table(name)))
    assert german.keys() == english.keys()
    assert all(text.strip() for text in [*english.values(), *german.values()])
    different = {key for key in english if placeholders(english[key]) != placeholders(german[key])}
    assert not different


def test_numbers_keep_the_decimals_that_they_have(texts: Texts) -> None:
    shown = {
        language: [texts.get(language).exact(one) for one in (0.0005, 0.95, 40_000, 2.0)] for language in ("de", "en")
    }
    assert shown == {"de": ["0,0005", "0,95", "40.000", "2"], "en": ["0.0005", "0.95", "40,000", "2"]}


def test_templates_only_use_texts_that_exist(texts: Texts) -> None:
    missing = [
        f"{file.relative_to(FRONTEND)}: {key}"
        for file in sorted((FRONTEND / "templates").rglob("*.html"))
        for key in CALL.findall(file.read_text(encoding="utf-8"))
        if not texts.get("en").knows(key)
    ]
    assert not missing


@pytest.mark.parametrize(
    ("group", "scripts"),
    [
        ("participant.join.script", ["join.js"]),
        ("participant.script", ["session.js", "stage-bar.js", "trial.js", "questions.js", "ranking.js", "wait.js"]),
    ],
)
def test_scripts_only_say_texts_that_their_page_carries(texts: Texts, group: str, scripts: list[str]) -> None:
    calls = [call for script in scripts for call in SAID.findall((FRONTEND / "static" / "js" / script).read_text())]
    said = {key for call in calls for key in KEY.findall(call)}
    assert said
    assert {key for key in said if not texts.get("en").knows(f"{group}.{key}")} == set()


def test_a_text_is_filled_in_the_language_s_own_notation(texts: Texts) -> None:
    assert texts.get("en")("participant.progress.pair", number=7, of=15) == "Pair 7 of 15"
    assert texts.get("de")("participant.progress.pair", number=7, of=1500) == "Paar 7 von 1.500"
    assert texts.get("de").number(0.5, 2) == "0,50"
    assert texts.get("en").percent(0.955, 1) == "95.5%"
    assert texts.get("de").percent(0.955, 1) == "95,5\N{NO-BREAK SPACE}%"
    assert texts.get("en").date(date(2026, 11, 21)) == "21 November 2026"
    assert texts.get("de").moment(datetime(2026, 11, 21, 9, 5, tzinfo=UTC)) == "21. November 2026, 09:05"


def test_plural_forms_follow_the_count(texts: Texts) -> None:
    say = texts.get("de")
    assert say("participant.script.open", count=1) == "Eine Frage ist noch offen."
    assert say("participant.script.open", count=3) == "3 Fragen sind noch offen."


def test_wrong_use_says_what_is_wrong(texts: Texts) -> None:
    say = texts.get("en")
    with pytest.raises(TextError, match=r"no text 'participant\.nothing'.*stopped at 'nothing'"):
        say("participant.nothing")
    with pytest.raises(TextError, match=r"needs a value for \{of\}; given: number"):
        say("participant.progress.pair", number=1)
    with pytest.raises(TextError, match="is a group of texts"):
        say("participant.trial")
    with pytest.raises(TextError, match="give count=NUMBER"):
        say("participant.script.open")


def test_the_language_follows_the_browser_among_those_offered(texts: Texts) -> None:
    assert texts.best("fr, de-CH;q=0.8, en;q=0.5") == "de"
    assert texts.best("de", offered=("en",)) == "en"
    assert texts.best("fr", offered=("de",)) == "de"
    assert texts.best("en;q=oops") == "en"
    assert texts.best(None) == "en"
    assert texts.get("fr").language == "en"


def test_browsers_translate_no_code_link_or_command() -> None:
    """Who translates a page still pastes the code that it showed."""
    code = re.compile(r'<code\b[^>]*>|<\w+\b[^>]*id="(?:completion-code|return-code|own-link)"[^>]*>')
    tags = [tag for page in (FRONTEND / "templates").rglob("*.html") for tag in code.findall(page.read_text("utf-8"))]
    assert len(tags) > 30
    assert [tag for tag in tags if 'translate="no"' not in tag] == []


@pytest.mark.parametrize(
    ("stored", "german"),
    [
        ("Halls, 15 answers of S001", "Halls, 15 Antworten von S001"),
        (
            "instant policy: Halls, 40 answers of 3 simulated participants in top_down, seed 0 against base, seed 1",
            "Sofort-Policy: Halls, 40 Antworten von 3 simulierten Teilnehmenden (von oben), Seed 0 gegen Basis, Seed 1",
        ),
        (
            "linear reward model: Halls, 2 answers of 2 people, seed 0",
            "Belohnungsmodell (lineares Bradley-Terry-Modell): Halls, 2 Antworten von 2 Menschen, Seed 0",
        ),
        (
            "instant policy: Example study (simulated people), 15 answers of S001, seed 2",
            "Sofort-Policy: Beispielstudie (simulierte Personen), 15 Antworten von S001, Seed 2",
        ),
        ("6 demonstrations in the corridor by S001", "6 Demonstrationen (corridor) von S001"),
        ("study_room/base", "study_room/base"),
        ("My policy: the best, ever", "My policy: the best, ever"),
    ],
)
def test_names_that_jobs_gave_are_shown_in_the_readers_language(texts: Texts, stored: str, german: str) -> None:
    assert artefact_name(stored, texts.get("en")) == stored
    assert artefact_name(stored, texts.get("de")) == german


def test_studies_that_come_with_the_product_are_named_in_the_readers_language(texts: Texts) -> None:
    for stored, german in (
        (texts.get("en")("lab.example.name"), "Beispielstudie (simulierte Personen)"),
        (DEMO_NAME, "Demo: den Roboter kennenlernen, der von Ihnen lernt"),
        ("Halls: an example", "Halls: an example"),
    ):
        assert study_name(stored, texts.get("en")) == stored
        assert study_name(stored, texts.get("de")) == german


LABELS = (
    "drawing.undo",
    "ranking.undo",
    "drawing.evaluation.start",
    "participant.trial.start",
    "participant.bar.pause",
)
"""Buttons that texts of studies name."""


def test_texts_of_studies_name_buttons_as_they_are_labelled(texts: Texts) -> None:
    named = []
    for english in sorted((PROTOCOLS / "texts").glob("*.en.md")):
        german = english.with_name(english.name.replace(".en.", ".de."))
        for label in LABELS if german.exists() else ():
            if re.search(rf"\b{texts.get('en')(label)}\b", english.read_text("utf-8")):
                named.append(label)
                assert texts.get("de")(label) in german.read_text("utf-8"), (german.name, label)
    assert set(named) == set(LABELS)
