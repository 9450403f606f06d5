"""The words that all rooms of a study share: views, what a stage shows, phases of a trial. No logic."""

from __future__ import annotations

from typing import Literal, get_args

View = Literal["top_down", "first_person", "immersive"]
VIEWS: tuple[str, ...] = get_args(View)
IN_HEADSET = (
    "headset"  # among the levels of a factor `view`: immersive with a headset, and immersive alone in the window
)
PersonMode = Literal["still", "walks", "recorded"]  # the person while the robot drives a drawn path

PLAYING = ("playing_a", "playing_b")  # phases of a trial in which a trajectory is on the stage

LABEL_S = 2.0  # ch. 7: the letter stands for 2 s before the robot moves
TOLERANCE_S = 0.3  # ours: how much earlier than due the news of a watched trajectory may come (clocks, rounding)
