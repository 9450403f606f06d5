"""Names that jobs give artefacts, and that the product gives its own studies, in the reader's language. They are stored
in English, a part between commas for each thing that tells them apart; what somebody named stays as it is."""

from __future__ import annotations

from desirepath.web.core.catalogues import DEFAULT_LANGUAGE, Catalogue

SEPARATORS = (" against ", ": ", ", ")
OWN_STUDIES = {  # a part of the name of a study that comes with the product -> its text
    "Example study (simulated people)": "lab.example.name",
    "meet the robot that learns from you": "lab.example.demo",
}


def artefact_name(name: str, t: Catalogue) -> str:
    """`name` with every part that a job wrote in the language of `t`."""
    return name if t.language == DEFAULT_LANGUAGE else _translate(name, t, SEPARATORS)


def study_name(name: str, t: Catalogue) -> str:
    """The name of a study; of one that comes with the product in the language of `t`."""
    return ": ".join(t(OWN_STUDIES[part]) if part in OWN_STUDIES else part for part in name.split(": "))


def _translate(name: str, t: Catalogue, separators: tuple[str, ...]) -> str:
    if not separators:
        return _part(name, t)
    separator, *finer = separators
    shown = t("analyst.names.against") if separator == " against " else separator
    return shown.join(_translate(part, t, tuple(finer)) for part in name.split(separator))


def _part(part: str, t: Catalogue) -> str:
    if part in OWN_STUDIES:
        return t(OWN_STUDIES[part])
    match part.split(" "):
        case ["seed", seed] if seed.isdigit():
            return t("analyst.names.seed", seed=seed)
        case [count, "scenes" | "queries" as what] if count.isdigit():
            return t(f"analyst.names.{what}", count=int(count))
        case [count, "answers", "of", *whom] if count.isdigit():
            return t("analyst.names.answers", count=int(count), whom=_whom(whom, t))
        case [count, "imported", "answers", "of", people, "people"]:
            return t("analyst.names.imported_answers", answers=count, people=people)
        case [count, "demonstrations", "in", "the", place, "by", *whom]:
            return t("analyst.names.demonstrations", answers=count, place=place, whom=_whom(whom, t))
        case ["ensemble", "member", number]:
            return t("analyst.names.member", number=number)
        case [kind, "reward", "model"]:
            known = f"analyst.choices.{kind}"
            return t("analyst.names.reward_model", kind=t(known) if t.knows(known) else kind)
        case [made, "policy"] if t.knows(f"analyst.names.policies.{made}"):
            return t(f"analyst.names.policies.{made}")
        case ["base" | "controller" | "uploaded" | "imported" as word]:
            return t(f"analyst.names.{word}")
    return part


def _whom(whom: list[str], t: Catalogue) -> str:
    match whom:
        case [*rest, "in", view] if t.knows(f"live.lab.views.{view}"):
            return t("analyst.names.in_view", whom=_whom(rest, t), view=t(f"live.lab.views.{view}"))
        case [count, "people" | "participants" as group] if count.isdigit():
            return t(f"analyst.names.{group}", people=count)
        case [count, "simulated", "participants"] if count.isdigit():
            return t("analyst.names.simulated", people=count)
    return " ".join(whom)
