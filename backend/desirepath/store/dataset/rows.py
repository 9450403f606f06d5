"""The rows of an exported study: marked, scrubbed, in a fixed order. Writing the files lives in `writing.py`.

Who took part under which recruiting id, from where and with which link never leaves the database; of who withdrew, or
is left out of data for publication, only that and when.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.analysis.scales import frozen_items
from desirepath.grammar.questionnaires import MARKS, frozen_questionnaire
from desirepath.store.dataset.columns import Table
from desirepath.store.dataset.tables import PARTICIPANTS, SESSIONS, TRIALS
from desirepath.store.events import FORBIDDEN_KEYS
from desirepath.store.models import (
    Event,
    Participant,
    ProtocolVersion,
    RecruitingId,
    Response,
    Study,
    TrajectoryRow,
    Trial,
)
from desirepath.store.models import Session as SessionRow
from desirepath.store.plain_data import copy_data, mentions
from desirepath.store.sides import chosen_and_rejected, is_side
from desirepath.store.who_counts import is_practice, left_out_of_study, may_be_published, reason_not_to_learn

Row = dict[str, Any]
TUNED = ("tuning", "words", "meet_your_robot", "robot_drive")  # kinds of answers that hold a history of changed weights
WRITTEN = ("sentence", "marked")  # of an answer of kind words: free text, as a questionnaire's
REMOVED = "[removed]"
MIN_SCRUBBED_LENGTH = 6  # a recruiting id shorter than this would blot out ordinary words
# Entries of an event's data that hold words and ids of ours; everything else may have been typed or sent by a page.
OWN_WORDS = frozenset(
    {
        *("step", "phase", "goes_on_with", "side", "drive", "response", "outcome", "code", "language"),
        *("job", "snapshot", "protocol", "hash", "tombstone"),
    }
)


class Content:
    """The rows of every table, in a fixed order, marked, scrubbed."""

    def __init__(self, s: Session, study: Study, *, pilots: bool, open_data: bool = False) -> None:
        """pilots: with the pilot participants. open_data: without the answers of who did not consent to publishing."""
        self.s, self.study, self.open_data = s, study, open_data
        everyone = list(
            s.scalars(select(Participant).where(Participant.study_id == study.id).order_by(Participant.code))
        )
        self.people = {person.id: person for person in everyone if pilots or not person.pilot}
        sessions = s.scalars(
            select(SessionRow).where(SessionRow.study_id == study.id).order_by(SessionRow.created_at, SessionRow.id)
        ).all()
        self.closed = {person.id for person in everyone if open_data and not may_be_published(person, study.protocol)}
        out = {
            person.id for person in everyone if person.withdrawn_at is not None or person.id not in self.people
        } | self.closed
        gone = {person.id: person.code for person in everyone if person.id in out}
        present = [row for row in sessions if row.participant_id not in gone]
        self.by_id = {row.id: row for row in sorted(present, key=lambda row: self.people[row.participant_id].code)}
        # what an event may call somebody who withdrew or is left out
        self.gone = {*gone, *gone.values()} | {row.id for row in sessions} - self.by_id.keys()
        order = {session_id: k for k, session_id in enumerate(self.by_id)}
        in_study = SessionRow.study_id == study.id
        trials = s.scalars(select(Trial).join(SessionRow, SessionRow.id == Trial.session_id).where(in_study))
        self.trial_rows = sorted(
            (trial for trial in trials if trial.session_id in order), key=lambda t: (order[t.session_id], t.index, t.id)
        )
        self.trial_by_id = {trial.id: trial for trial in self.trial_rows}
        answers = s.scalars(select(Response).join(SessionRow, SessionRow.id == Response.session_id).where(in_study))
        self.answers = sorted(
            (answer for answer in answers if answer.session_id in order),
            key=lambda r: (order[r.session_id], r.created_at, r.id),
        )
        self.devices_before: dict[str, list[tuple[datetime, Row]]] = {}
        changes = select(Event).where(Event.study_id == study.id, Event.kind == "device_checked").order_by(Event.id)
        for change in s.scalars(changes):
            self.devices_before.setdefault(change.session_id or "", []).append((change.at, change.data["before"]))
        self.consent_versions = {
            answer.id: answer.value.get("version") for answer in self.answers if answer.kind == "consent"
        }
        self._steps: dict[str, dict[str, Row]] = {}
        self.secrets = _recruiting_words(s, study.id)
        self.chosen_items = _items_without_free_text(s, study)

    def participants(self) -> Iterator[Row]:
        for person in self.people.values():
            withdrawn = person.withdrawn_at is not None
            shown = not withdrawn and person.id not in self.closed
            consents = person.consents or {}
            yield {
                **stored_columns(PARTICIPANTS, person),
                **self._of_participant(person),
                "withdrawn": withdrawn,
                "training": consents.get("training"),
                "open_data": consents.get("open_data"),
                "oracle": as_json(person.oracle) if shown else None,
                "excluded_reason": self._scrub(person.excluded_reason) if shown else None,
            }

    def sessions(self) -> Iterator[Row]:
        for row in self.by_id.values():
            yield {**stored_columns(SESSIONS, row), **self.of_session(row.id)}

    def planned_steps(self) -> Iterator[Row]:
        for session in self.by_id.values():
            for index, step in enumerate(session.plan):
                yield {
                    **self.of_session(session.id),
                    "index": index,
                    "step": step["key"],
                    "role": step.get("role"),
                    **{name: step.get(name) for name in ("kind", "stage", "block", "view", "query", "questionnaire")},
                    "planned": as_json(step),
                }

    def trials(self) -> Iterator[Row]:
        for trial in self.trial_rows:
            yield {
                **stored_columns(TRIALS, trial),
                **self.of_session(trial.session_id),
                "trial": trial.id,
                "practice": is_practice(trial.role),
                "step": trial.step_key,
                "query": trial.query_id,
                "look_alike": (trial.arms or {}).get("look_alike"),
            }

    def responses(self) -> Iterator[Row]:
        for answer in self.answers:
            trial = self.trial_by_id.get(answer.trial_id or "")
            choice = answer.value.get("choice")
            yield {
                "response": answer.id,
                "trial": answer.trial_id,
                **self.of_session(answer.session_id),
                "practice": trial is not None and is_practice(trial.role),
                "step": answer.step_key,
                "kind": answer.kind,
                "view": trial.view if trial else None,
                "role": trial.role if trial else None,
                "query": trial.query_id if trial else None,
                "device": as_json(self._device_of(answer)),
                "choice": choice if isinstance(choice, str) else None,
                "value": as_json(self._value(answer)),
                "decision_s": answer.decision_s,
                "consent": answer.consent_id,
                "consent_version": self.consent_versions.get(answer.consent_id or ""),
                "client_time": answer.client_time,
                "created_at": answer.created_at,
            }

    def _device_of(self, answer: Response) -> Row:
        """What the answer was given on: the session's device, or the one before it was changed."""
        changed = (before for at, before in self.devices_before.get(answer.session_id, ()) if at > answer.created_at)
        return next(changed, self.by_id[answer.session_id].device)

    def items(self) -> Iterator[Row]:
        for answer in self.answers:
            step = self._step_of(answer)
            if answer.kind != "questionnaire" and not step.get("rates"):
                continue
            for item, value in sorted(self._value(answer).items()):
                if item in MARKS:
                    continue
                is_number = isinstance(value, int | float) and not isinstance(value, bool)
                yield {
                    "response": answer.id,
                    **self.of_session(answer.session_id),
                    "step": answer.step_key,
                    "item": item,
                    "questionnaire": step.get("questionnaire") or step.get("stage"),
                    "condition": step.get("block"),
                    "answer": value if isinstance(value, str) else as_json(value),
                    "answer_number": float(value) if is_number else None,
                }

    def tuning_changes(self) -> Iterator[Row]:
        for answer in self.answers:
            if answer.kind not in TUNED:
                continue
            for index, change in enumerate(answer.value.get("history", [])):
                yield {
                    "response": answer.id,
                    **self.of_session(answer.session_id),
                    "step": answer.step_key,
                    "index": index,
                    **{name: change[name] for name in ("seconds", "place", "by", "objective", "weight")},
                }

    def rankings(self) -> Iterator[Row]:
        """Importance rankings, object by object in the order in which they were ranked."""
        for answer in self.answers:
            trial = self.trial_by_id.get(answer.trial_id or "")
            if answer.kind != "importance_ranking" or trial is None:
                continue
            value = answer.value
            placed = value["placed_s"] or [None] * len(value["ranking"])
            for rank, (thing, seconds) in enumerate(zip(value["ranking"], placed, strict=True), start=1):
                yield {
                    "response": answer.id,
                    "trial": trial.id,
                    **self.of_session(answer.session_id),
                    "practice": is_practice(trial.role),
                    "step": answer.step_key,
                    "condition": trial.block,
                    "outline": value["outline"],
                    "lidar": value["lidar"],
                    "attention": value.get("attention", False),
                    "query": trial.query_id,
                    "thing": thing,
                    "rank": rank,
                    "score": value["scores"][thing],
                    "placed_s": seconds,
                    "undone": value["undone"],
                    "decision_s": answer.decision_s,
                }

    def _step_of(self, answer: Response) -> Row:
        """The step of the plan that was answered; empty where the plan does not have it."""
        if answer.session_id not in self._steps:
            self._steps[answer.session_id] = {step["key"]: step for step in self.by_id[answer.session_id].plan}
        return self._steps[answer.session_id].get(answer.step_key, {})

    def events(self) -> Iterator[Row]:
        events = self.s.scalars(select(Event).where(Event.study_id == self.study.id).order_by(Event.id))
        nobody = {"session": None, "participant": None, "simulated": None, "excluded": None}
        present = (e for e in events if e.session_id not in self.gone and not mentions(e.data, self.gone))
        for number, event in enumerate(present, start=1):
            known = event.session_id in self.by_id
            yield {
                "number": number,
                "at": event.at,
                **(self.of_session(event.session_id) if known and event.session_id else nobody),
                "trial": event.trial_id,
                "kind": event.kind,
                "client_time": event.client_time,
                "data": as_json({key: v if key in OWN_WORDS else self._scrub_all(v) for key, v in event.data.items()}),
            }

    def pairs(self, stored: dict[str, TrajectoryRow]) -> Iterator[Row]:
        for answer in self.answers:
            trial = self.trial_by_id.get(answer.trial_id or "")
            choice = answer.value.get("choice")
            if trial is None or not is_side(choice):
                continue
            person = self.people[self.by_id[answer.session_id].participant_id]
            chosen, rejected = chosen_and_rejected(choice, trial.trajectory_a, trial.trajectory_b)
            yield {
                "response": answer.id,
                **self._of_participant(person),
                "practice": is_practice(trial.role),
                "source": "simulated" if person.simulated else "human",
                "kind": trial.kind,
                "role": trial.role,
                "view": trial.view,
                "query": trial.query_id,
                "setup": stored[chosen].setup,
                "scene_hash": stored[chosen].scene_hash,
                "chosen": chosen,
                "rejected": rejected,
                "chosen_shown": "first" if choice == "a" else "second",
            }

    def learned_from(self) -> set[str]:
        """Codes of those whose answers models may learn from."""
        return {person.code for person in self.people.values() if reason_not_to_learn(person, "all") is None}

    def of_session(self, session_id: str) -> Row:
        return {"session": session_id, **self._of_participant(self.people[self.by_id[session_id].participant_id])}

    def _of_participant(self, person: Participant) -> Row:
        return {
            "participant": person.code,
            "simulated": person.simulated,
            "excluded": left_out_of_study(person) == "excluded",
        }

    def _value(self, answer: Response) -> Row:
        """The answer's value, with what was typed freely scrubbed; every other kind of answer holds our own words."""
        if answer.kind == "words":
            typed = {name: self._scrub_all(answer.value[name]) for name in WRITTEN if name in answer.value}
            return {**answer.value, **typed}
        if answer.kind == "rules":
            return {**answer.value, **{name: self._scrub_all(answer.value[name]) for name in ("rules", "history")}}
        if answer.kind != "questionnaire":
            return answer.value
        return {
            item: value if item in self.chosen_items else self._scrub_all(value) for item, value in answer.value.items()
        }

    def _scrub_all(self, value: Any) -> Any:
        """Plain data with every text in it scrubbed."""
        return copy_data(value, text=self._scrub) if self.secrets else value

    def _scrub(self, text: str | None) -> str | None:
        """The text without any recruiting id of this study, wherever it came in (an address bar, a free-text field)."""
        for word in self.secrets if text else ():
            text = text.replace(word, REMOVED) if text else text
        return text


def stored_columns(table: Table, stored: Any) -> Row:
    """The columns of a table that stand in the database as they are, of one of its rows."""
    in_json = {column.name for column in table.columns if column.json}
    values = {name: getattr(stored, name) for name in table.kept_in(stored)}
    return {name: as_json(value) if name in in_json else value for name, value in values.items()}


def as_json(value: Any) -> str | None:
    """JSON without the entries that must not leave the database."""
    if value is None:
        return None
    allowed = copy_data(value, without=lambda key, _: key.lower() in FORBIDDEN_KEYS)
    return json.dumps(allowed, sort_keys=True, ensure_ascii=False)


def _items_without_free_text(s: Session, study: Study) -> set[str]:
    """Keys of the items whose answers were chosen or counted, in every questionnaire that has them."""
    chosen: set[str] = set()
    typed: set[str] = set()
    versions = s.scalars(select(ProtocolVersion.files).where(ProtocolVersion.study_id == study.id))
    for name, content in (file for files in (study.files, *versions) for file in files.items()):
        if name.startswith("scales/"):  # a validated scale's items, see study/protocol/reading.py
            chosen |= {item["key"] for item in frozen_items(content)}
        elif name.startswith("questionnaires/"):
            for item in frozen_questionnaire(name, content).items:
                (typed if item.type == "text" else chosen).add(item.key)
    return chosen - typed


def _recruiting_words(s: Session, study_id: str) -> list[str]:
    words: set[str] = set()
    for row in s.scalars(select(RecruitingId).where(RecruitingId.study_id == study_id)):
        words |= {row.external_id, *(value for value in row.details.values() if isinstance(value, str))}
    return sorted((word for word in words if len(word) >= MIN_SCRUBBED_LENGTH), key=len, reverse=True)
