"""The tables of a data set, every column with its meaning. Filling them lives in `rows.py`, files in `writing.py`.

The one source of the Parquet schemas, the data dictionary, the descriptions that tools read, and the import.
"""

from __future__ import annotations

from desirepath.store.dataset.columns import (
    FLOATS,
    IS_CODE,
    IS_ID,
    IS_KEY,
    IS_SHA,
    MOMENT,
    NUMBER,
    TEXT,
    WHOLE,
    YES_NO,
    Column,
    Table,
)

_MARKS = (
    Column("simulated", YES_NO, "true: a simulated participant (a program), not a person"),
    Column("excluded", YES_NO, "true: an experimenter excluded the participant; leave out of analyses"),
)
_TRIAL_MARKS = (
    Column("practice", YES_NO, "true: a practice trial; stored, never analysed"),
    *_MARKS,
)
_PARTICIPANT = Column("participant", TEXT, "pseudonymous code, unique in the study", form=IS_CODE)
_SESSION = Column("session", TEXT, "id of the session", form=IS_ID)
_OF_PARTICIPANT = ("participant", "participants", "participant")
_OF_SESSION = ("session", "sessions", "session")
_OF_RESPONSE = ("response", "responses", "response")
_TRAJECTORY = ("trajectories", "trajectory")

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
    key=("participant",),
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
        Column("position", WHOLE, "index of the step reached, from 0"),
        Column("device", TEXT, "screen and input of the last device used, as far as the page reported", json=True),
        Column(
            "personalisation",
            TEXT,
            "whether the comparison with the own policy was shown, and why not: shown, too_few_answers, job_failed, "
            "late, gate_not_passed, not_surely_better (for this very person), no_consent (to learning from the "
            "answers), one_sided (position bias), too_fast (to have compared), no_scenes",
        ),
        Column(
            "predictive_check",
            TEXT,
            "whether the answers look like what is believed of them: answers predicted one by one, how many came true "
            "and should have, p; odds: how many times more probable they are by that than by a coin; "
            "better_than_chance: whether that is enough to say what this person prefers; "
            "something_else: probability that they are about more than the nine objectives; "
            "personal: probability that the own policy is better for this person; prior: how many earlier "
            "participants' answers these were read by the light of, where the protocol says so",
            json=True,
        ),
        Column("created_at", MOMENT, "when the session was made"),
        Column("opens_at", MOMENT, "later appointments: from when the link worked"),
        Column("started_at", MOMENT, "when the first step was begun"),
        Column("finished_at", MOMENT, "when it ended; empty if it did not"),
        Column("last_seen_at", MOMENT, "last sign of life of the page"),
        Column("expires_at", MOMENT, "until when the link worked"),
    ),
    key=("session",),
    refers=(_OF_PARTICIPANT,),
)
PLANNED_STEPS = Table(
    "planned_steps",
    "step of a session's plan, in the order they were planned; not every step is met",
    (
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("index", WHOLE, "order within the plan, from 0"),
        Column("step", TEXT, "key of the step; trials and answers name it", form=IS_KEY),
        Column("kind", TEXT, "what is done there: consent, trial, comparison, questionnaire, ..."),
        Column("stage", TEXT, "stage of the protocol that it belongs to"),
        Column("block", TEXT, "experimental condition, as in trials"),
        Column("view", TEXT, "view of a trial"),
        Column("role", TEXT, "role of a trial, as in trials"),
        Column("query", TEXT, "query of a trial, where it is known before the session"),
        Column("questionnaire", TEXT, "questionnaire that is asked"),
        Column("planned", TEXT, "the whole step as it was planned", json=True),
    ),
    key=("session", "index"),
    refers=(_OF_SESSION, _OF_PARTICIPANT),
)
TRIALS = Table(
    "trials",
    "trial (one query or comparison shown)",
    (
        Column("trial", TEXT, "id of the trial", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("step", TEXT, "key of the trial's step in the plan", form=IS_KEY),
        Column("index", WHOLE, "order within the session"),
        Column("block", TEXT, "experimental condition (e.g. the view), where the protocol has several"),
        Column(
            "kind",
            TEXT,
            "query (two trajectories), comparison (base and own policy), method_comparison (the robots that two "
            "methods resulted in), or one alone: rating, evaluation, importance_ranking",
        ),
        Column(
            "role",
            TEXT,
            "practice, regular, or a probe: repeat (asked again), swap (asked again, A "
            "and B exchanged), transitivity (the three pairs of three trajectories in one scene)",
        ),
        Column("probe_of", TEXT, "repeat and swap: the trial that is asked again", form=IS_ID),
        Column("view", TEXT, "top_down, first_person or immersive (a desktop camera unless the device says headset)"),
        Column("query", TEXT, "id of the query, the same wherever it is asked"),
        Column(
            "sides_swapped",
            YES_NO,
            "true: the query's second trajectory was shown as A; empty in comparisons",
        ),
        Column("trajectory_a", TEXT, "trajectory shown first; see trajectories", form=IS_SHA),
        Column("trajectory_b", TEXT, "trajectory shown second; see trajectories", form=IS_SHA),
        Column(
            "arms",
            TEXT,
            "comparison only: which policy (artefact id) rolled out a and b, which is their own, and which another "
            "participant's (other; lent: the same for equal policies; stand_in: a simulated person's) or the "
            "conditioned policy without preferences (neutral), where that was compared; else the other is the base "
            "one. method_comparison: by which method the robots a and b were taught (choices, drawing, words, sliders)",
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
    key=("trial",),
    refers=(_OF_SESSION, _OF_PARTICIPANT, ("trajectory_a", *_TRAJECTORY), ("trajectory_b", *_TRAJECTORY)),
)
RESPONSES = Table(
    "responses",
    "answer (of any step, also consent and questionnaires)",
    (
        Column("response", TEXT, "id of the answer", form=IS_ID),
        Column("trial", TEXT, "id of the trial it answers; empty for other steps", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("step", TEXT, "key of the step", form=IS_KEY),
        Column("kind", TEXT, "what was asked: preference, comparison, questionnaire, comprehension, consent, ..."),
        Column("view", TEXT, "view of the trial"),
        Column("role", TEXT, "role of the trial; further: asked on, teaches and is not analysed"),
        Column("query", TEXT, "query of the trial"),
        Column(
            "device",
            TEXT,
            "the device it was given on, as far as its page reported: the session's, or the one before it was changed",
            json=True,
        ),
        Column("choice", TEXT, "what was chosen, a or b, where that was the question"),
        Column("value", TEXT, "the whole answer as it was given", json=True),
        Column("decision_s", NUMBER, "seconds from the choice becoming possible to the answer"),
        Column("consent", TEXT, "the consent in force: id of its answer; empty before it was given", form=IS_ID),
        Column("consent_version", TEXT, "version of that consent's text; its hash is in the consent's value"),
        Column("client_time", MOMENT, "when it was given by the browser's clock"),
        Column("created_at", MOMENT, "when it was stored by the server's clock"),
    ),
    key=("response",),
    refers=(_OF_SESSION, _OF_PARTICIPANT, ("trial", "trials", "trial")),
)
ITEMS = Table(
    "questionnaire_items",
    "item of an answered questionnaire, or rating of what a trial showed",
    (
        Column("response", TEXT, "id of the answer the item belongs to", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("step", TEXT, "key of the questionnaire's step", form=IS_KEY),
        Column("item", TEXT, "key of the item; its wording is in the protocol"),
        Column("questionnaire", TEXT, "name of the questionnaire"),
        Column("condition", TEXT, "experimental condition that was rated, as `block` of trials; else empty"),
        Column("answer", TEXT, "the answer; several choices are a JSON list"),
        Column("answer_number", NUMBER, "the answer where it is a number, e.g. 1 to 7"),
    ),
    key=("response", "item"),
    refers=(_OF_RESPONSE, _OF_SESSION, _OF_PARTICIPANT),
)
TUNING_CHANGES = Table(
    "tuning_changes",
    "change of a preference weight by hand (kinds of step `tuning`, `words` and `meet_your_robot`)",
    (
        Column("response", TEXT, "id of the answer that holds the final weights", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("step", TEXT, "key of the step", form=IS_KEY),
        Column("index", WHOLE, "order of the changes, from 0; from the answer's `start` they lead to its `weights`"),
        Column("seconds", NUMBER, "since the page was opened, browser's clock"),
        Column("place", WHOLE, "in which of the step's scenes it was tried, from 0"),
        Column("by", TEXT, "mouse, touch, pen, keys, button (all of them set back), words or bot"),
        Column("objective", TEXT, "which weight; raising one of two opposites puts the other to 0"),
        Column("weight", NUMBER, "its new value, 0 to 1"),
    ),
    key=("response", "index"),
    refers=(_OF_RESPONSE, _OF_SESSION, _OF_PARTICIPANT),
)
RANKINGS = Table(
    "importance_rankings",
    "ranked object of an importance ranking",
    (
        Column("response", TEXT, "id of the answer", form=IS_ID),
        Column("trial", TEXT, "id of the trial it answers", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("step", TEXT, "key of the step", form=IS_KEY),
        Column("condition", TEXT, "experimental condition, as `block` of trials"),
        Column("outline", YES_NO, "whether outlines showed the objects' scores"),
        Column("lidar", YES_NO, "whether the lidar's rays were shown"),
        Column("attention", YES_NO, "whether what the policy attends to was shown; of people alone"),
        Column("query", TEXT, "id of the rollout that was shown, the same wherever it is asked"),
        Column("thing", TEXT, "the object, by kind and number as the scene has it; person: who takes part"),
        Column("rank", WHOLE, "place that it was given: 1 the most important"),
        Column(
            "score",
            NUMBER,
            "how much it moved the policy's speed, or was attended to, at the halt, 0 to 1; 0 also: not seen",
        ),
        Column("placed_s", NUMBER, "seconds until it was put there; empty: not reported"),
        Column("undone", WHOLE, "how often a place was taken back in this trial"),
        Column("decision_s", NUMBER, "seconds from ranking becoming possible to the answer"),
    ),
    key=("response", "thing"),
    refers=(_OF_RESPONSE, _OF_SESSION, _OF_PARTICIPANT, ("trial", "trials", "trial")),
)
CODEBOOK = Table(
    "codebook",
    "code that the lab reads answers in participants' own words by",
    (
        Column("item", TEXT, "key of the open question", form=IS_KEY),
        Column("code", TEXT, "name of the code, unique in the question's codebook"),
        Column("definition", TEXT, "when it is given"),
        Column("created_at", MOMENT, "when it was written"),
    ),
    key=("item", "code"),
)
CODINGS = Table(
    "codings",
    "code that a coder gave to an answer in a participant's own words",
    (
        Column("response", TEXT, "id of the answer", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("item", TEXT, "key of the open question", form=IS_KEY),
        Column(
            "coder",
            TEXT,
            "first or second, who did not know of each other's codes nor of the condition; agreed: what was settled on "
            "where they differed",
        ),
        Column("code", TEXT, "a code that was given; empty: none of the codebook fits"),
        Column("coded_at", MOMENT, "when"),
    ),
    key=("response", "item", "coder", "code"),
    refers=(_OF_RESPONSE, _OF_SESSION, _OF_PARTICIPANT),
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
        Column("trial", TEXT, "id of the trial it is about, where there is one", form=IS_ID),
        Column("kind", TEXT, "what happened"),
        Column("client_time", MOMENT, "when, browser's clock"),
        Column("data", TEXT, "details", json=True),
    ),
    key=("number",),
    refers=(_OF_SESSION, _OF_PARTICIPANT),
)
PAIRS = Table(
    "pairs",
    "answered query as chosen and rejected trajectory, for preference learning",
    (
        Column("response", TEXT, "id of the answer", form=IS_ID),
        _PARTICIPANT,
        *_TRIAL_MARKS,
        Column("source", TEXT, "human or simulated"),
        Column("kind", TEXT, "query or comparison; comparisons are no training answers"),
        Column("role", TEXT, "as in trials; repeat, swap and transitivity are no independent answers"),
        Column("view", TEXT, "view it was answered in"),
        Column("query", TEXT, "id of the query"),
        Column("setup", TEXT, "setup of both trajectories"),
        Column("scene_hash", TEXT, "sha256 of the scene both ran in", form=IS_SHA),
        Column("chosen", TEXT, "trajectory that was chosen", form=IS_SHA),
        Column("rejected", TEXT, "trajectory that was not", form=IS_SHA),
        Column("chosen_shown", TEXT, "first or second: position of the chosen one"),
    ),
    key=("response",),
    refers=(_OF_RESPONSE, _OF_PARTICIPANT, ("chosen", *_TRAJECTORY), ("rejected", *_TRAJECTORY)),
)
STROKES = Table(
    "strokes",
    "path that was drawn (every attempt, also those that were taken back)",
    (
        Column("stroke", TEXT, "id of the stroke; the answer that kept it names it", form=IS_ID),
        _SESSION,
        _PARTICIPANT,
        *_MARKS,
        Column("step", TEXT, "key of the step it was drawn at", form=IS_KEY),
        Column("attempt", WHOLE, "order within the step, from 1"),
        Column("environment", TEXT, "setup of the scene: corridor, room, study_room or home"),
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
        ),
        Column("state", TEXT, "kept (learned from), redone (taken back), refused (cannot be driven), drawn or watched"),
        Column("problem", TEXT, "refused only: code, place and numbers of what was wrong", json=True),
        Column(
            "demonstration",
            TEXT,
            "sha256 of its file in demonstrations/: spline, commands, rollout; empty if refused",
            form=IS_SHA,
        ),
        Column("trajectory", TEXT, "the robot's rollout along it with all transitions; see trajectories", form=IS_SHA),
        Column("watched_at", MOMENT, "when the rollout had been watched to its end, server's clock"),
        Column("client_time", MOMENT, "when it was sent, browser's clock"),
        Column("created_at", MOMENT, "when it was stored, server's clock"),
        Column("left_out_at", MOMENT, "when an analyst decided not to learn from it; empty if not"),
        Column("left_out_by", TEXT, "who decided that"),
        Column("left_out_reason", TEXT, "and why"),
    ),
    key=("stroke",),
    refers=(_OF_SESSION, _OF_PARTICIPANT, ("trajectory", *_TRAJECTORY)),
)
TRAJECTORIES = Table(
    "trajectories",
    "trajectory shown in the study; the arrays are in trajectories/ID.npz and in trajectory_steps.parquet",
    (
        Column("trajectory", TEXT, "sha256 of its NPZ file, which has that name", form=IS_SHA),
        Column("setup", TEXT, "scene generator, robot limits, observation layout and core reward"),
        Column("scene_hash", TEXT, "sha256 of the scene", form=IS_SHA),
        Column("scene", TEXT, "the whole scene: room, obstacles, person (m, rad), start, goal, goal radius", json=True),
        Column("outcome", TEXT, "success, collision, timeout, or running (cut before the end)"),
        Column("steps", WHOLE, "control steps"),
        Column("dt_s", NUMBER, "seconds per control step"),
        Column("robot_radius_m", NUMBER, "radius of the robot: clearances are from its surface"),
        Column("duration_s", NUMBER, "seconds from start to end"),
        Column("self_intersections", WHOLE, "how often the path crossed itself"),
        Column(
            "made_by",
            TEXT,
            "artefact id of the policy, where it is known; recording:SHA256:FILE of one recorded elsewhere",
        ),
        Column("created_at", MOMENT, "when it was stored"),
    ),
    key=("trajectory",),
)
METRICS = Table(
    "trajectory_metrics",
    "trajectory, with what the report compares (backend/desirepath/analysis/metrics.py; poses every dt_s)",
    (
        Column("trajectory", TEXT, "id of the trajectory", form=IS_SHA),
        Column("outcome", TEXT, "as in trajectories"),
        Column("time_s", NUMBER, "seconds from start to end"),
        Column("path_length_m", NUMBER, "length of the path"),
        Column("mean_speed_m_per_s", NUMBER, "length by time"),
        Column("accumulated_angle_rad", NUMBER, "sum of all changes of heading"),
        Column(
            "min_human_distance_m",
            NUMBER,
            "smallest distance from the robot's centre to a person's, whoever comes nearest",
        ),
        Column(
            "min_obstacle_distance_m",
            NUMBER,
            "smallest distance from the robot's surface to an obstacle or wall, the person not counted; empty: none",
        ),
        Column("path_area_m2", NUMBER, "area between the path and the straight line from start to goal"),
        Column("straight_distance_m", NUMBER, "from start to goal"),
        Column("relative_path_length", NUMBER, "length by that distance"),
        Column(
            "personal_space_violations",
            NUMBER,
            "how often the robot came within 1.2 m of a person (centres; Hall 1966)",
        ),
        Column("personal_space_time_s", NUMBER, "seconds within these 1.2 m"),
        Column(
            "min_time_to_collision_s",
            NUMBER,
            "least time until robot and anybody would touch if both went on as they move; 0: they touched; at most 10",
        ),
        Column("stalled_time_s", NUMBER, "seconds slower than 0.05 m/s"),
        Column("mean_jerk_m_per_s3", NUMBER, "mean absolute jerk of the forward speed"),
        Column(
            "path_irregularity_rad_per_m",
            NUMBER,
            "turning beyond what facing the goal at the start takes, per metre (Guzzi et al. 2013)",
        ),
        Column(
            "spl",
            NUMBER,
            "success weighted by path length (Anderson et al. 2018): straight distance by length, 0 if not arrived",
        ),
    ),
    key=("trajectory",),
    refers=(("trajectory", *_TRAJECTORY),),
)
STEPS = Table(
    "trajectory_steps",
    "control step of a trajectory",
    (
        Column("trajectory", TEXT, "id of the trajectory", form=IS_SHA),
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
    key=("trajectory", "step"),
    refers=(("trajectory", *_TRAJECTORY),),
)
TABLES = (
    *(PARTICIPANTS, SESSIONS, PLANNED_STEPS, TRIALS, RESPONSES, ITEMS, TUNING_CHANGES, RANKINGS),
    *(CODEBOOK, CODINGS, EVENTS, PAIRS, STROKES),
    *(TRAJECTORIES, METRICS, STEPS),
)
