"""What an exported data set consists of: its tables, every column with its meaning, its file names.

The one source of the Parquet schemas, the data dictionary and the import. Filling the tables lives in `export.py`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

FORMAT = "desirepath-dataset-6"
# 3 has no strokes.walk; 4 no responses.device, and fixed completion codes in the protocol; 5 other names of columns
READABLE = ("desirepath-dataset-3", "desirepath-dataset-4", "desirepath-dataset-5", FORMAT)
STUDY_FILE = "study.json"
CHECKSUMS_FILE = "checksums.sha256"
DICTIONARY_FILE = "data-dictionary.md"
PROTOCOL_FOLDER = "protocol"
TRAJECTORY_FOLDER = "trajectories"
DEMONSTRATION_FOLDER = "demonstrations"

TEXT, WHOLE, NUMBER, YES_NO = pa.string(), pa.int64(), pa.float64(), pa.bool_()
MOMENT = pa.timestamp("us", tz="UTC")
FLOATS = pa.list_(pa.float32())


@dataclass(frozen=True)
class Column:
    """One column. json: the text is a JSON value. newer: older data sets that can still be read do not have it. former:
    what it was called in those of before format 6."""

    name: str
    type: pa.DataType
    meaning: str
    json: bool = False
    newer: bool = False
    former: str | None = None

    def type_name(self) -> str:
        """The type in words a reader of CSV understands."""
        words = {TEXT: "text", WHOLE: "whole number", NUMBER: "number", YES_NO: "true/false", MOMENT: "time, UTC ISO"}
        return "text, JSON" if self.json else words.get(self.type, "list of numbers")

    def formerly(self) -> str:
        """What the dictionary says of the name it had."""
        return f" (`{self.former}` before format 6)" if self.former else ""


@dataclass(frozen=True)
class Table:
    """One table: one row per `row`."""

    name: str
    row: str
    columns: tuple[Column, ...]
    csv: bool = True

    def schema(self) -> pa.Schema:
        """The Parquet schema; every column says what it means."""
        return pa.schema(
            [pa.field(c.name, c.type, metadata={"meaning": c.meaning}) for c in self.columns],
            metadata={"format": FORMAT, "row": self.row},
        )

    def unpacked(self, row: dict[str, Any]) -> dict[str, Any]:
        """The row with its JSON columns as plain data. Raises ValueError naming the column that is no JSON."""
        found = dict(row)
        for column in self.columns:
            if column.json and found[column.name] is not None:
                try:
                    found[column.name] = json.loads(found[column.name])
                except ValueError:
                    raise ValueError(f"{column.name} = {found[column.name]!r} is no JSON") from None
        return found


_MARKS = (
    Column("simulated", YES_NO, "true: a simulated participant (a program), not a person"),
    Column("excluded", YES_NO, "true: an experimenter excluded the participant; leave out of analyses"),
)
_TRIAL_MARKS = (
    Column("practice", YES_NO, "true: a practice trial; stored, never analysed", former="learning"),
    *_MARKS,
)
_PARTICIPANT = Column("participant", TEXT, "pseudonymous code, unique in the study")
_SESSION = Column("session", TEXT, "id of the session")

PARTICIPANTS = Table(
    "participants",
    "participant",
    (
        _PARTICIPANT,
        *_MARKS,
        Column(
            "pilot", YES_NO, "true: joined while the study was a pilot; in the data set only where it was asked for"
        ),
        Column("withdrawn", YES_NO, "true: the participant withdrew; nothing else of theirs is in the data set"),
        Column("training", YES_NO, "whether they agreed that models learn from their answers; empty: was not asked"),
        Column("open_data", YES_NO, "whether they agreed that their answers are published; empty: was not asked"),
        Column("oracle", TEXT, "simulated only: the oracle's name and settings", json=True),
        Column("created_at", MOMENT, "when they followed the recruiting link"),
        Column("withdrawn_at", MOMENT, "when they withdrew; empty if not"),
        Column("excluded_at", MOMENT, "when they were excluded; empty if not"),
        Column("excluded_reason", TEXT, "why they were excluded, in the experimenter's words; empty if they withdrew"),
    ),
)
SESSIONS = Table(
    "sessions",
    "session (one appointment of a participant)",
    (
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("state", TEXT, "active, paused, completed, expired or screened_out"),
        Column("ended_because", TEXT, "screened_out only: comprehension (check not passed) or quota (full)"),
        Column("appointment", WHOLE, "which of the participant's appointments, from 1"),
        Column("protocol_number", WHOLE, "which protocol of the study it ran on: 1 its first, 2 and on in protocol/"),
        Column(
            "assignment",
            TEXT,
            "place in the counterbalancing: scheme, row of rows (null: by lot), order of conditions, per block",
            json=True,
        ),
        Column("language", TEXT, "language of the pages: en or de"),
        Column("seed", WHOLE, "seed of the session's plan (order of queries, of A and B)"),
        Column("plan", TEXT, "the steps in the order they were planned", json=True),
        Column("position", WHOLE, "index of the step reached, from 0"),
        Column("device", TEXT, "screen and input of the last device used, as far as the page told", json=True),
        Column(
            "personalisation",
            TEXT,
            "whether the comparison with the own policy was shown, and why not: shown, too_few_answers, job_failed, "
            "late, gate_not_passed, no_consent (to learning from the answers), no_scenes",
        ),
        Column("created_at", MOMENT, "when the session was made"),
        Column("opens_at", MOMENT, "later appointments: from when the link worked"),
        Column("started_at", MOMENT, "when the first step was begun"),
        Column("finished_at", MOMENT, "when it ended; empty if it did not"),
        Column("last_seen_at", MOMENT, "last sign of life of the page"),
        Column("expires_at", MOMENT, "until when the link worked"),
    ),
)
TRIALS = Table(
    "trials",
    "trial (one query or comparison shown)",
    (
        Column("trial", TEXT, "id of the trial"),
        _SESSION,
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("step", TEXT, "key of the trial's step in the plan"),
        Column("index", WHOLE, "order within the session"),
        Column("block", TEXT, "experimental condition (e.g. the view), where the protocol has several"),
        Column("kind", TEXT, "query (two trajectories), comparison (base and own policy) or evaluation (one alone)"),
        Column(
            "role",
            TEXT,
            "practice (`learning` before format 6), regular, or a probe: repeat (asked again), swap (asked again, A "
            "and B exchanged), transitivity (the three pairs of three trajectories in one scene)",
        ),
        Column("probe_of", TEXT, "repeat and swap: the trial that is asked again"),
        Column("view", TEXT, "top_down, first_person or immersive (a desktop camera unless the device says headset)"),
        Column("query", TEXT, "id of the query, the same wherever it is asked"),
        Column(
            "sides_swapped",
            YES_NO,
            "true: the query's second trajectory was shown as A; empty in comparisons",
            former="turned",
        ),
        Column("trajectory_a", TEXT, "trajectory shown first; see trajectories"),
        Column("trajectory_b", TEXT, "trajectory shown second; see trajectories"),
        Column(
            "arms",
            TEXT,
            "comparison only: which policy (artefact id) rolled out a and b, which is their own, and which another "
            "participant's (other), where that was compared; else the one that is not their own is the base policy",
            True,
        ),
        Column(
            "look_alike",
            YES_NO,
            "comparison only: true: a person can hardly tell the two trajectories apart (paths closer than the "
            "smallest gap of a query, about equally long), so the choice says little; shown only where too few others "
            "were found",
        ),
        Column("phase", TEXT, "how far it came: ready, playing_a, playing_b, choosing or answered"),
        Column("phase_since", MOMENT, "when that phase began"),
        Column("a_seen_at", MOMENT, "when A had been seen to the end, server's clock"),
        Column("b_seen_at", MOMENT, "when B had been seen to the end, server's clock"),
        Column("restarts", WHOLE, "how often it started over (reload, hidden tab, lost connection)"),
        Column("replays", WHOLE, "how often it was watched again before the choice, where the protocol allows it"),
    ),
)
RESPONSES = Table(
    "responses",
    "answer (of any step, also consent and questionnaires)",
    (
        Column("response", TEXT, "id of the answer"),
        Column("trial", TEXT, "id of the trial it answers; empty for other steps"),
        _SESSION,
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("step", TEXT, "key of the step"),
        Column("kind", TEXT, "what was asked: preference, comparison, questionnaire, comprehension, consent, ..."),
        Column("view", TEXT, "view of the trial"),
        Column("role", TEXT, "role of the trial"),
        Column("query", TEXT, "query of the trial"),
        Column(
            "device",
            TEXT,
            "the device it was given on, as far as its page told: the session's, or the one before it was changed",
            json=True,
            newer=True,
        ),
        Column("choice", TEXT, "what was chosen, a or b, where that was the question"),
        Column("value", TEXT, "the whole answer as it was given", json=True),
        Column("decision_s", NUMBER, "seconds from the choice becoming possible to the answer"),
        Column("consent", TEXT, "the consent in force: id of its answer; empty before it was given"),
        Column("consent_version", TEXT, "version of that consent's text; its hash is in the consent's value"),
        Column("client_time", MOMENT, "when it was given by the browser's clock"),
        Column("created_at", MOMENT, "when it was stored by the server's clock"),
    ),
)
ITEMS = Table(
    "questionnaire_items",
    "item of an answered questionnaire",
    (
        Column("response", TEXT, "id of the answer the item belongs to"),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("step", TEXT, "key of the questionnaire's step"),
        Column("item", TEXT, "key of the item; its wording is in the protocol"),
        Column("answer", TEXT, "the answer; several choices are a JSON list"),
        Column("answer_number", NUMBER, "the answer where it is a number, e.g. 1 to 7"),
    ),
)
EVENTS = Table(
    "events",
    "event of the append-only log",
    (
        Column("number", WHOLE, "order within the study, from 1"),
        Column("at", MOMENT, "when, server's clock"),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("trial", TEXT, "id of the trial it is about, where there is one"),
        Column("kind", TEXT, "what happened"),
        Column("client_time", MOMENT, "when, browser's clock"),
        Column("data", TEXT, "details", json=True),
    ),
)
PAIRS = Table(
    "pairs",
    "answered query as chosen and rejected trajectory, for preference learning",
    (
        Column("response", TEXT, "id of the answer"),
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("source", TEXT, "human or simulated"),
        Column("kind", TEXT, "query or comparison; comparisons are no training answers"),
        Column("role", TEXT, "as in trials; repeat, swap and transitivity are no independent answers"),
        Column("view", TEXT, "view it was answered in"),
        Column("query", TEXT, "id of the query"),
        Column("setup", TEXT, "setup of both trajectories"),
        Column("scene_hash", TEXT, "sha256 of the scene both ran in"),
        Column("chosen", TEXT, "trajectory that was chosen"),
        Column("rejected", TEXT, "trajectory that was not"),
        Column("chosen_shown", TEXT, "first or second: position of the chosen one"),
    ),
)
STROKES = Table(
    "strokes",
    "path that was drawn (every attempt, also those that were taken back)",
    (
        Column("stroke", TEXT, "id of the stroke; the answer that kept it names it"),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("step", TEXT, "key of the step it was drawn at"),
        Column("attempt", WHOLE, "order within the step, from 1"),
        Column("environment", TEXT, "setup of the scene: corridor or room"),
        Column("pair", WHOLE, "which of the environment's places (start, goal, person), from 0"),
        Column("view", TEXT, "view it was drawn in"),
        Column("pointer", TEXT, "mouse, touch, pen or keys, several joined by +; bot: a simulated demonstrator"),
        Column(
            "drawn", TEXT, "raw: points ([x, y] m on the floor), speeds (m/s wanted there), times_s (of the hand)", True
        ),
        Column(
            "walk",
            TEXT,
            "how the person walked while the robot drove; empty: they stood. source: walked (by the participant; "
            "simulated where a program did; raw poses [x m, y m, yaw rad] at times_s, which begin with the rollout; "
            "beside: the trajectory they walked beside) or planned (by a program, chosen by the participant; mode, "
            "seed). spline: knots times_s, x, y, yaw of monotone cubics, as in the scene of the trajectory",
            json=True,
            newer=True,
        ),
        Column("state", TEXT, "kept (learned from), redone (taken back), refused (cannot be driven), drawn or watched"),
        Column("problem", TEXT, "refused only: code, place and numbers of what was wrong", json=True),
        Column(
            "demonstration",
            TEXT,
            "sha256 of its file in demonstrations/: spline, commands, rollout; empty if refused",
        ),
        Column("trajectory", TEXT, "the robot's rollout along it with all transitions; see trajectories"),
        Column("watched_at", MOMENT, "when the rollout had been watched to its end, server's clock"),
        Column("client_time", MOMENT, "when it was sent, browser's clock"),
        Column("created_at", MOMENT, "when it was stored, server's clock"),
        Column("left_out_at", MOMENT, "when an analyst decided not to learn from it; empty if not"),
        Column("left_out_by", TEXT, "who decided that"),
        Column("left_out_reason", TEXT, "and why"),
    ),
)
TRAJECTORIES = Table(
    "trajectories",
    "trajectory shown in the study; the arrays are in trajectories/ID.npz and in trajectory_steps.parquet",
    (
        Column("trajectory", TEXT, "sha256 of its NPZ file, which has that name"),
        Column("setup", TEXT, "scene generator, robot limits, observation layout and core reward"),
        Column("scene_hash", TEXT, "sha256 of the scene"),
        Column("scene", TEXT, "the whole scene: room, obstacles, person (m, rad), start, goal, goal radius", json=True),
        Column("outcome", TEXT, "success, collision, timeout, or running (cut before the end)"),
        Column("steps", WHOLE, "control steps"),
        Column("dt_s", NUMBER, "seconds per control step"),
        Column("duration_s", NUMBER, "seconds from start to end"),
        Column("self_intersections", WHOLE, "how often the path crossed itself"),
        Column("made_by", TEXT, "artefact id of the policy, where it is known"),
        Column("created_at", MOMENT, "when it was stored"),
    ),
)
STEPS = Table(
    "trajectory_steps",
    "control step of a trajectory",
    (
        Column("trajectory", TEXT, "id of the trajectory"),
        Column("step", WHOLE, "from 0"),
        Column("time_s", NUMBER, "seconds since the start, at the beginning of the step"),
        Column("x_m", NUMBER, "robot's position at the beginning of the step; right-handed, z up"),
        Column("y_m", NUMBER, "robot's position at the beginning of the step"),
        Column("yaw_rad", NUMBER, "robot's heading, counter-clockwise from +x"),
        Column("next_x_m", NUMBER, "position at the end of the step"),
        Column("next_y_m", NUMBER, "position at the end of the step"),
        Column("next_yaw_rad", NUMBER, "heading at the end of the step"),
        Column("action_linear", NUMBER, "in [-1, 1]; -1 is the setup's lowest speed, 1 its highest"),
        Column("action_angular", NUMBER, "in [-1, 1]; 1 is the setup's fastest turn to the left"),
        Column("reward", NUMBER, "core reward of the setup, without any preference"),
        Column("done", YES_NO, "true: the trajectory ended with this step"),
        Column("observation", FLOATS, "the state as the policy saw it; layout and scaling: study.json, setups"),
        Column("next_observation", FLOATS, "the state after the step"),
    ),
    csv=False,
)
TABLES = (PARTICIPANTS, SESSIONS, TRIALS, RESPONSES, ITEMS, EVENTS, PAIRS, STROKES, TRAJECTORIES, STEPS)


def data_dictionary() -> str:
    """The data dictionary in Markdown, as it lies in every data set and in docs/."""
    lines = [
        "# Data dictionary",
        "",
        "What the files of an exported study mean. Written by `desirepath export`; do not edit by hand.",
        "",
        "Every table comes as Parquet (typed, exact; what `desirepath import` reads) and, if not said otherwise, as",
        "CSV (UTF-8, comma, quotes doubled). In CSV, a text that a spreadsheet could take for a formula (beginning",
        "with `=`, `+`, `-`, `@`, tab or line break) has an apostrophe put before it. Units are SI and in the column's",
        "name; angles are radians. Ids are random or hashes; nothing that identifies a person is exported: no",
        "recruiting ids (where one was typed into a text it reads `[removed]`), no network addresses, no link tokens,",
        "no completion codes, no problem reports. A completion code that is the same for everybody reads `REMOVED` in",
        "the protocol's copy, and the address people return by `https://removed.invalid/`; `sha256` in",
        f"`{STUDY_FILE}` is the protocol's as it ran, `written_sha256` that of this copy. Free-text answers are",
        "exported as they were written: read them before you publish.",
        "",
        "**Who withdrew** is one row in `participants` with code and times, so that the flow of participants adds up.",
        "Their sessions, trials, answers, events and the trajectories that only they saw are not in the data set. Data",
        "sets written before they withdrew still hold them: replace those by a new one.",
        "",
        "**Data for publication** (`--open-data`) hold nothing of who did not agree to it but that row.",
        "",
        "**Before you analyse**, leave out rows with `excluded` or `practice` true, and decide about `simulated` ones.",
        "",
        "**Where the person stood** is in the scene: `person.pose.x` and `person.pose.y` (metres, in the same frame as",
        "`poses`) and `person.pose.yaw` (radians) of column `scene` and of `scene` in a trajectory's `meta`.",
        "",
        "| file | holds |",
        "|---|---|",
        f"| `{STUDY_FILE}` | study, protocol hash, setups, licence, citation, counts |",
        f"| `{PROTOCOL_FOLDER}/` | the study's frozen copy of the protocol and its texts |",
        f"| `{TRAJECTORY_FOLDER}/ID.npz` | arrays of one trajectory: `poses` (T+1, 3: x m, y m, yaw rad), "
        "`observations` and `next_observations` (T, n), `actions` (T, 2), `rewards` (T), `dones` (T); `meta`: JSON "
        "bytes with scene, outcome, dt. Read with `numpy.load(path, allow_pickle=False)` |",
        f"| `{DEMONSTRATION_FOLDER}/ID.npz` | one demonstration, where paths were drawn: `stroke_points`, "
        "`stroke_speeds`, `stroke_times_s` as drawn; cubic B-splines `spline_knots`, `spline_coefficients`, "
        "`speed_knots`, `speed_coefficients`; `commands` (T, 2: m/s, rad/s); `trajectory`: bytes of its NPZ |",
        f"| `{DICTIONARY_FILE}` | this text |",
        f"| `{CHECKSUMS_FILE}` | sha256 of every other file; check with `sha256sum -c {CHECKSUMS_FILE}` |",
    ]
    for table in TABLES:
        endings = "`.csv`, `.parquet`" if table.csv else "`.parquet` only"
        lines += ["", f"## {table.name}", "", f"One row per {table.row}. {endings}", "", "| column | type | meaning |"]
        lines += ["|---|---|---|"]
        lines += [f"| `{c.name}` | {c.type_name()} | {c.meaning}{c.formerly()} |" for c in table.columns]
    return "\n".join(lines) + "\n"
