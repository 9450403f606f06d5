"""The words that several modules of this room share: stages, views, phases, codes. No logic."""

from __future__ import annotations

from typing import Literal, get_args

View = Literal["top_down", "first_person", "immersive"]
VIEWS: tuple[str, ...] = get_args(View)
PersonMode = Literal["still", "walks", "recorded"]  # the person while the robot drives a drawn path

STAGE_KINDS = (
    "information",
    "consent",
    "questionnaire",
    "comprehension",
    "instruction",
    "block",
    "demonstrations",
    "break",
    "train",
    "comparison",
    "evaluation",
    "appointment",
    "debriefing",
)
TRIAL_KINDS = ("trial", "comparison", "evaluation")  # steps that are shown on the stage
SINGLE_KINDS = ("evaluation",)  # of these the ones that show one drive
DRAWN_KINDS = ("demonstration",)  # steps at which a path is drawn on the stage
PLAYING = ("playing_a", "playing_b")

LABEL_S = 2.0  # spec 07: the letter stands for 2 s before the robot moves
TOLERANCE_S = 0.3  # ours: how much earlier than due the news of a watched drive may come (clocks, rounding)
