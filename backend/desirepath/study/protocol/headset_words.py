"""What an information or consent text must say where a headset is worn: shipped sentences, and which texts lack them.

They stand in the texts themselves, which are frozen and hashed with the study, and may be said in other words.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from desirepath.grammar.source import Problem, Source
from desirepath.grammar.texts import variant
from desirepath.study.kinds.consent import ConsentStage
from desirepath.study.kinds.information import InformationStage
from desirepath.study.protocol.schema import Protocol

HEADSET = {
    "en": "With a headset we also store whether it was worn, what its browser calls the controllers, and how many "
    "pictures a second it showed.",
    "de": "Mit einem Headset speichern wir auch, ob es getragen wurde, wie sein Browser die Controller nennt und wie "
    "viele Bilder in der Sekunde es zeigte.",
}
HEAD = {
    "en": "While you wear the headset we also store, 30 times a second, where your head is in the room shown and which "
    "way it faces.",
    "de": "Solange Sie das Headset tragen, speichern wir auch 30-mal in der Sekunde, wo im gezeigten Raum Ihr Kopf ist "
    "und wohin er gerichtet ist.",
}
NAMES_HEADSET = re.compile(r"\bheadset|\bVR-Brille", re.IGNORECASE)
NAMES_HEAD = {"de": re.compile(r"\bkopf", re.IGNORECASE)}
IN_ENGLISH = re.compile(r"\bhead\b", re.IGNORECASE)


def head_problems(protocol: Protocol, files: Mapping[str, str], source: Source) -> Iterator[Problem]:
    """Where poses of heads would be stored of people who were not told. files: the texts, by name."""
    gate = protocol.asked_of_devices
    here = ("device", "head_pose")
    if gate.head_pose and gate.headset is None:
        yield source.problem(here, "needs headset: offered or required; without one no head's pose is known")
    elif gate.head_pose:
        for language in protocol.languages:
            if not NAMES_HEAD.get(language, IN_ENGLISH).search(_told(protocol, files, language)):
                yield source.problem(here, _lacks("head's pose", HEAD, language))


def headset_warnings(protocol: Protocol, files: Mapping[str, str], source: Source) -> Iterator[Problem]:
    """Languages in which no text says that a headset is worn, and what is stored of it."""
    if protocol.asked_of_devices.headset is not None:
        for language in protocol.languages:
            if not NAMES_HEADSET.search(_told(protocol, files, language)):
                yield source.problem(("device", "headset"), _lacks("headset", HEADSET, language))


def _lacks(what: str, sentences: Mapping[str, str], language: str) -> str:
    sentence = sentences.get(language, sentences["en"])
    return f"no information or consent text ({language}) names the {what}; write into one: {sentence}"


def _told(protocol: Protocol, files: Mapping[str, str], language: str) -> str:
    """All that people read of the study before and as they consent."""
    shown = [stage.text for stage in protocol.stages_of(InformationStage)]
    shown += [stage.text for stage in protocol.stages_of(ConsentStage)]
    names = (name for text in shown for name in (variant(text, language), text))
    return "\n".join(files[name] for name in names if name in files)
