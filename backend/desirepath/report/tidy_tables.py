"""Makes a study's tidy rows from its tables: a data set in a folder, or what this installation stores.

Both are the same tables (`store/dataset`), so a report is the same wherever it is made.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.analysis.scales import Scale, frozen_items, frozen_scale
from desirepath.grammar.questionnaires import MARKS, Item, ItemBlock, frozen_questionnaire
from desirepath.grammar.texts import local
from desirepath.learning.rules.rule import Rule
from desirepath.report.study_data import (
    Choice,
    Comparison,
    Degree,
    Guess,
    ImportanceRanking,
    ItemText,
    Load,
    MarkedDrive,
    Meeting,
    MethodChoice,
    ParticipantRow,
    Rating,
    SeveralAnswer,
    StudyData,
    Taught,
    ToldRules,
)
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.dataset.reading import read_dataset
from desirepath.store.dataset.writing import answers_of
from desirepath.store.marks import marks_in
from desirepath.store.models import ProtocolVersion, Study
from desirepath.store.sides import SIDES, chosen_and_rejected, is_answer_to_several, is_side, shown_on
from desirepath.store.who_counts import FURTHER

Row = dict[str, Any]
Tables = Mapping[str, Sequence[Row]]
QUESTIONNAIRES = "questionnaires/"
METHOD_COMPARISON = "method_comparison"
TAUGHT_BY = ("trial", "demonstration", "words", "tuning")  # kinds of step in which a method is done


def read_folder(folder: Path) -> tuple[StudyData, Load]:
    """A data set written by `desirepath studies export`. Raises DatasetError if it is none or was changed."""
    dataset = read_dataset(folder)
    about = dataset.about
    data = tidy(
        about.name,
        about.study,
        dataset.protocol,
        about.protocol.sha256,
        dataset.files,
        dataset.tables,
        later=[(version["protocol"], version["files"]) for version in dataset.later],
    )
    return data, dataset.trajectory


def read_study(s: Session, files: ArtefactStore, study: Study) -> tuple[StudyData, Load]:
    """A study of this installation, as it stands now."""
    versions = s.scalars(
        select(ProtocolVersion).where(ProtocolVersion.study_id == study.id).order_by(ProtocolVersion.number)
    )
    later = [(version.protocol, version.files) for version in versions]
    tables = answers_of(s, study)
    data = tidy(study.name, study.id, study.protocol, study.protocol_hash, study.files, tables, later=later)
    return data, lambda trajectory: load_trajectory(files, trajectory)


def tidy(
    name: str,
    study: str,
    protocol: Row,
    protocol_hash: str,
    files: Mapping[str, str],
    tables: Tables,
    *,
    later: Sequence[tuple[Row, Mapping[str, str]]] = (),
) -> StudyData:
    """Tables as exported (JSON columns as plain data) as tidy rows. files: the texts that the protocol names. later:
    the study's later protocols with theirs, in order."""
    for _, newer in later:
        files = {**files, **newer}
    sessions: dict[str, list[Row]] = defaultdict(list)
    for row in sorted(tables["sessions"], key=lambda row: row["created_at"]):
        sessions[row["participant"]].append(row)
    # a choice whose time was over names no trajectory
    answers = {row["trial"]: row for row in tables["responses"] if row["trial"] and is_side(row["choice"])}
    # whoever is asked on was judged hard to teach: these answers would count some people's more than others'
    trials = [row for row in tables["trials"] if row["trial"] in answers and row["role"] != FURTHER]
    further = Counter(
        row["participant"] for row in tables["trials"] if row["trial"] in answers and row["role"] == FURTHER
    )
    items = [*_items(files), *_rated_items(row["plan"] for row in tables["sessions"])]
    checks = {(item.questionnaire, item.key) for item in items if item.instructed}
    session = {row["session"]: row for row in tables["sessions"]}
    plans = {name: row["plan"] for name, row in session.items()}
    return StudyData(
        name=name,
        study=study,
        protocol=protocol,
        protocol_hash=protocol_hash,
        items=items,
        people=[
            _person(row, sessions[row["participant"]], further[row["participant"]]) for row in tables["participants"]
        ],
        choices=[
            _choice(row, answers[row["trial"]], session[row["session"]]) for row in trials if row["kind"] == "query"
        ],
        ratings=[of for of in _ratings(tables["responses"], plans) if (of.questionnaire, of.item) not in checks],
        comparisons=[compared for row in trials if (compared := _comparison(row, answers[row["trial"]])) is not None],
        newest=later[-1][0] if later else None,
        scales=list(_scales(files)),
        guesses=[
            Guess(row["participant"], bool(row["value"]["right"]))
            for row in tables["responses"]
            if row["kind"] == "guess" and "right" in row["value"]
        ],
        meetings=[
            Meeting(
                row["participant"],
                int(row["value"]["agreement"]),
                bool(row["value"]["corrected"]),
                float(row["value"]["distance"]),
            )
            for row in tables["responses"]
            if row["kind"] == "meet_your_robot"
        ],
        importance=list(_importance(tables)),
        method_choices=[
            MethodChoice(
                row["participant"],
                *chosen_and_rejected(answers[row["trial"]]["choice"], row["arms"]["a"], row["arms"]["b"]),
                look_alike=bool(row["arms"].get("look_alike")),
            )
            for row in trials
            if row["kind"] == METHOD_COMPARISON
        ],
        taught=list(_taught(tables["responses"], plans)),
        degrees=list(_degrees(tables)),
        told_rules=list(_told_rules(tables["responses"], plans)),
        several=list(_several(tables)),
        marked=list(_marked(tables)),
    )


def _told_rules(responses: Sequence[Row], plans: Mapping[str, Sequence[Row]]) -> Iterator[ToldRules]:
    for row in responses:
        if row["kind"] == "rules":
            value = row["value"]
            step = next((one for one in plans.get(row["session"], ()) if one["key"] == row["step"]), {})
            read = [
                (known, own)
                for told, own in zip(value["rules"], value["read"], strict=False)
                if (known := _known(told))
            ]
            yield ToldRules(
                row["participant"],
                tuple(rule for rule, _ in read),
                [own for _, own in read],
                [one["shown"] for one in value["picked"]],
                value["edits"],
                int(step.get("scenes", 1)),
            )


def _known(rule: Any) -> Rule | None:
    """None of what is no rule here: an imported data set may be of another version."""
    try:
        return Rule.model_validate(rule)
    except ValidationError:
        return None


def _degrees(tables: Tables) -> Iterator[Degree]:
    """Of the regular pairs where more than A or B could be said."""
    regular = {row["trial"]: row for row in tables["trials"] if row["kind"] == "query" and row["role"] == "regular"}
    for row in tables["responses"]:
        if row["trial"] in regular and "possible" in row["value"]:
            trial = regular[row["trial"]]
            yield Degree(row["participant"], trial["block"] or trial["view"], row["value"].get("degree"))


def _marked(tables: Tables) -> Iterator[MarkedDrive]:
    """Also such in which nothing was marked."""
    trials = {row["trial"]: row for row in tables["trials"] if row["kind"] == "mark"}
    for row in tables["responses"]:
        trial, marks = trials.get(row["trial"]), marks_in(row["value"])
        if trial is not None and marks is not None:
            said = tuple((mark.at_s, mark.why) for mark in marks)
            yield MarkedDrive(row["participant"], trial["block"] or trial["view"], trial["trajectory_a"], said)


def _several(tables: Tables) -> Iterator[SeveralAnswer]:
    """Orders, best ones and piles."""
    trials = {row["trial"]: row for row in tables["trials"] if row["kind"] == "order"}
    for row in tables["responses"]:
        trial, value = trials.get(row["trial"]), row["value"]
        count = len(((trial or {}).get("arms") or {}).get("shown", ()))
        if trial is None or not is_answer_to_several(value, count):
            continue
        best = value["order"][:1] if "order" in value else next(pile for pile in reversed(value["groups"]) if pile)
        about = (trial["block"] or trial["view"], value["ask"], count)
        yield SeveralAnswer(row["participant"], *about, best[0] if len(best) == 1 else None, row["decision_s"])


def _taught(responses: Sequence[Row], plans: Mapping[str, Sequence[Row]]) -> Iterator[Taught]:
    """What each method taught, by the answers to the comparisons of its robot."""
    known: dict[str, dict[str, Mapping[str, float]]] = {}
    for row in responses:
        if row["kind"] == METHOD_COMPARISON:
            for side in SIDES:
                value = row["value"]
                known.setdefault(row["session"], {})[value["methods"][side]] = value["weights"][side]
    for session, of in known.items():
        mine = sorted((row for row in responses if row["session"] == session), key=lambda row: row["created_at"])
        blocks = {step["key"]: step.get("block") for step in plans[session] if step["kind"] in TAUGHT_BY}
        for method, weights in sorted(of.items()):
            places = [k for k, row in enumerate(mine) if blocks.get(row["step"]) == method]
            began, ended = (mine[places[0] - 1], mine[places[-1]]) if places and places[0] else (None, None)
            took = None
            if began is not None and ended is not None:
                took = (_time(ended["created_at"]) - _time(began["created_at"])).total_seconds()
            yield Taught(mine[0]["participant"], method, weights, took)


def _time(time: datetime | str) -> datetime:
    return datetime.fromisoformat(time) if isinstance(time, str) else time


def _person(row: Row, sessions: Sequence[Row], further: int) -> ParticipantRow:
    last: Row = sessions[-1] if sessions else {}
    order: list[str] = []
    for session in sessions:
        for step in session["plan"]:
            if step.get("block") and step["block"] not in order:
                order.append(step["block"])
    return ParticipantRow(
        code=row["participant"],
        simulated=row["simulated"],
        excluded=(row["excluded_reason"] or "no reason given") if row["excluded"] else None,
        withdrawn=row["withdrawn"],
        state=last.get("state", "none"),
        order=tuple(order),
        groups=(last.get("assignment") or {}).get("groups", {}),
        own_policy=next(
            (session["personalisation"] for session in reversed(sessions) if session.get("personalisation")), None
        ),
        further=further,
    )


def _choice(trial: Row, answer: Row, session: Row) -> Choice:
    """session: its device is that of the answers of data sets which do not tell those apart."""
    told = (session if answer["device"] is None else answer)["device"] or {}
    device = {name: value for name, value in told.items() if name != "headset"}  # that says whether one is there
    if worn := [bool(of) for of in (trial.get("headset") or {}).values()]:
        device |= {"headset": "all" if all(worn) else "partly"} if any(worn) else {}
    return Choice(
        person=trial["participant"],
        condition=trial["block"] or trial["view"],
        view=trial["view"],
        query=trial["query"],
        role=trial["role"],
        first=trial["trajectory_a"],
        second=trial["trajectory_b"],
        chosen=shown_on(answer["choice"], trial["trajectory_a"], trial["trajectory_b"]),
        decision_s=answer["decision_s"],
        device=device,
    )


def _comparison(trial: Row, answer: Row) -> Comparison | None:
    if trial["kind"] != "comparison" or trial["arms"] is None:
        return None
    arms = trial["arms"]
    sides = {side: arm for arm, side in arms.items() if arm not in SIDES and is_side(side)}
    shown = [sides.get(side, "base") for side in SIDES]
    opponent = next((arms.get(side) for side, arm in zip(SIDES, shown, strict=True) if arm != "own"), None)
    return Comparison(
        trial["participant"],
        *chosen_and_rejected(answer["choice"], *shown),
        look_alike=bool(arms.get("look_alike")),
        opponent=arms.get("lent") or opponent,
        stand_in=bool(arms.get("stand_in")),
        earlier=arms.get("people"),
    )


def _importance(tables: Tables) -> Iterator[ImportanceRanking]:
    trials = {row["trial"]: row for row in tables["trials"]}
    for row in tables["responses"]:
        if row["kind"] == "importance_ranking" and row["trial"]:
            trial, value = trials[row["trial"]], row["value"]
            yield ImportanceRanking(
                person=row["participant"],
                condition=trial["block"] or trial["view"],
                query=trial["query"],
                role=trial["role"],
                outline=bool(value["outline"]),
                lidar=bool(value["lidar"]),
                attention=bool(value.get("attention", False)),
                ranking=tuple(value["ranking"]),
                scores={str(thing): float(score) for thing, score in value["scores"].items()},
                decision_s=row["decision_s"],
            )


def _ratings(responses: Sequence[Row], plans: Mapping[str, Sequence[Row]]) -> Iterator[Rating]:
    """Items of questionnaires as they were answered; ratings of what was shown, averaged over what one person rated
    under one condition."""
    shown: dict[tuple[str, str | None, str, str], list[float]] = defaultdict(list)
    steps = {session: {step["key"]: step for step in plan} for session, plan in plans.items()}
    for row in responses:
        step = steps[row["session"]].get(row["step"], {})
        item = step.get("rates")
        if item is not None and item in row["value"]:
            shown[row["participant"], step.get("block"), step["stage"], item].append(float(row["value"][item]))
        if row["kind"] == "questionnaire":
            for name, value in row["value"].items():
                if name not in MARKS:
                    yield Rating(
                        row["participant"], step.get("block"), step["questionnaire"], name, value, step.get("stage", "")
                    )
    for (person, condition, stage, item), values in shown.items():
        yield Rating(person, condition, stage, item, sum(values) / len(values), stage)


def _blocks(files: Mapping[str, str]) -> Iterator[tuple[str, ItemBlock, str | None]]:
    """Every block of every questionnaire, with the questionnaire's name and the study's copy of the scale it asks."""
    for name, content in files.items():
        if name.startswith(QUESTIONNAIRES):
            for block in frozen_questionnaire(name, content).blocks:
                copy = files[f"scales/{block.scale}.json"] if block.scale else None
                yield name.removeprefix(QUESTIONNAIRES).removesuffix(".yaml"), block, copy


def _items(files: Mapping[str, str]) -> Iterator[ItemText]:
    """In English, as papers are; in the study's first language where it has no English."""
    for questionnaire, block, copy in _blocks(files):
        for item in [Item(**stored) for stored in frozen_items(copy)] if copy else block.items:
            yield ItemText(
                questionnaire=questionnaire,
                key=item.key,
                type=item.type,
                text=local(item.text, "en"),
                points=item.points,
                options={option.value: local(option.label, "en") for option in item.options},
                reversed=item.reversed,
                instructed=item.instructed is not None,
            )


def _scales(files: Mapping[str, str]) -> Iterator[tuple[str, Scale]]:
    return (
        (questionnaire, scored)
        for questionnaire, _, copy in _blocks(files)
        if copy
        for scored in frozen_scale(copy).scored
    )


def _rated_items(plans: Iterable[Sequence[Row]]) -> list[ItemText]:
    """What was rated of trajectories that were shown, as one item per stage."""
    rated = {(step["stage"], step["rates"]): step for plan in plans for step in plan if step.get("rates")}
    return [
        ItemText(stage, item, "scale", f"{item} of {stage}".replace("_", " "), step.get("points", 7), {})
        for (stage, item), step in sorted(rated.items())
    ]
