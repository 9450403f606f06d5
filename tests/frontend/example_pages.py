"""The participants' pages with example contents, served as they are: real templates, scripts, styles and catalogues.

No study runs behind them: these tests are about what a page looks like and what it offers to a keyboard and to a screen
reader. How a page behaves in a running study is in test_session_page.py and in tests/journeys.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from starlette.responses import Response

from desirepath.store.marks import MOST_MARKS, WHYS
from desirepath.study.kinds.live import CONTROLS, CROWD_CONTROLS
from desirepath.study.kinds.order import COLOURS
from desirepath.web.core.catalogues import Texts
from desirepath.web.core.guides import prose

FRONTEND = Path(__file__).resolve().parents[2] / "frontend"
CONTACT = "Dr. Ada Muster, ada@example.org"
TITLE = "How should the robot pass you?"
GATE: dict[str, Any] = {
    "webgl": True,
    "min_width": 740,
    "min_height": 500,
    "pointers": ["fine", "coarse"],
    "min_frame_rate": None,
    "light_below": None,
    "headset": None,
    "head_pose": False,
}


def _gate(request: Request) -> dict[str, Any]:
    """What a device must have: the example's, with what the address says otherwise."""
    said = {name: value for name, value in request.query_params.items() if name in GATE}
    read = {"pointers": lambda value: [value], "headset": str}
    return GATE | {name: read.get(name, float)(value) for name, value in said.items()}


WHEN = datetime(2026, 11, 28, 12, 30, tzinfo=UTC)


def _scale(key: str) -> dict[str, Any]:
    return {"key": key, "text": f"Question {key}?", "type": "scale", "points": 7, "low": "not at all", "high": "very"}


_ITEMS: list[dict[str, Any]] = [
    {"key": "age", "text": "How old are you?", "type": "number", "min": 18, "max": 110},
    {
        "key": "vision",
        "text": "How well do you see?",
        "type": "choice",
        "options": [{"value": "well", "label": "Well"}, {"value": "badly", "label": "Badly"}],
    },
    _scale("one"),
    _scale("two"),
    _scale("three"),
    _scale("four"),
    {"key": "remark", "text": "Anything else?", "type": "text", "required": False},
]
_VIEWS = [{"value": label.lower(), "label": label} for label in ("Above", "Eyes", "Room")]
_PURPOSES = [{"key": "training", "text": "Robots may learn from them?"}, {"key": "open_data", "text": "Publish them?"}]
_TIMES = {"opens_at": WHEN, "expires_at": WHEN + timedelta(days=7)}

STEPS: dict[str, dict[str, Any]] = {
    "information": {"title": TITLE, "text": "Two *short* paragraphs.\n\n## What you do\n\n- watch\n- choose"},
    "consent": {
        "title": "Consent",
        "text": "Of my own free will.",
        "points": ["I am 18.", "I agree."],
        "purposes": _PURPOSES,
        "version": "1",
    },
    "questionnaire": {"title": "About you", "text": "A few questions.", "items": _ITEMS},
    "skipping": {
        "title": "Robots",
        "text": "",
        "blocks": [
            {"title": None, "items": [_ITEMS[1], {**_ITEMS[0], "when": [{"item": "vision", "is": "well"}]}]},
            {"title": None, "items": [{**_scale("old"), "when": [{"item": "age", "at_least": 60}]}]},
            {"title": None, "items": [_scale("all")]},
        ],
    },
    "ranking": {
        "title": "The three views",
        "text": "",
        "items": [
            {"key": key, "text": f"Most {key}?", "type": "ranking", "options": _VIEWS, "low": "most", "high": "least"}
            for key in ("useful", "easy")
        ],
    },
    "comprehension": {
        "title": "Is it clear?",
        "text": "Watch **both** drives.",
        "items": [_ITEMS[1]],
        "attempt": 2,
        "attempts": 2,
        "time_limit_s": 90,
    },
    "break": {"title": "A short break", "text": "Look out of the window.", "at_least_s": 2},
    "attention": {"instructed": "b"},
    "appointment": {
        "title": "See you again",
        "text": "Thank you.",
        **_TIMES,
        "return_code": "R-7KX2",
        "return_path": "/p/next",
    },
    "too_soon": _TIMES,
    "screened_out": {"title": None, "text": None, "completion_code": None, "return_url": None},
    "instruction": {"title": "How it works", "text": "Imagine that you are the person."},
    "trial": {"role": "practice", "view": "top_down", "number": 1, "of": 15},
    "comparison": {"role": "regular", "view": "top_down", "number": 1, "of": 3},
    "method_comparison": {"role": "regular", "view": "top_down", "number": 1, "of": 12},
    "rating": {
        "view": "top_down",
        "number": 1,
        "of": 4,
        "points": 7,
        "question": "How did you like it?",
        "low": "not at all",
        "high": "very much",
    },
    "order": {
        "view": "top_down",
        "number": 1,
        "count": 3,
        "of": 4,
        "ask": "order",
        "piles": None,
        "question": None,
        "colours": COLOURS,
        "durations_s": [4.2, 6.0, 5.4, 8.8],
    },
    "mark": {
        "view": "top_down",
        "number": 1,
        "of": 10,
        "good": True,
        "question": None,
        "reasons": list(WHYS),
        "most": MOST_MARKS,
    },
    "tuning": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": CONTROLS,
        "question": None,
        "start": {"farther": 0.5, "smoother": 0.25},
    },
    "think_aloud": {"title": "Your thoughts", "text": "What did you look at?", "minutes": 3},
    "robot_drive": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 1,
        "controls": CONTROLS,
        "question": None,
        "start": {"farther": 0.5},
        "points": 7,
    },
    "words": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": CONTROLS,
        "question": None,
        "longest": 300,
    },
    "rules": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": [],
        "question": None,
        "longest": 300,
        "least": 1,
        "most": 12,
        "most_wishes": 4,
        "most_changes": 400,
    },
    "feedback": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 1,
        "controls": (),
        "triangle": None,
        "number": 3,
        "of": 15,
        "answers": 3,
    },
    "triangle": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": CONTROLS,
        "triangle": ["farther", "slower_near_person", "shorter"],
        "question": None,
        "start": {"farther": 0.34, "slower_near_person": 0.33, "shorter": 0.33},
    },
    "meet_something_else": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": CONTROLS,
        "start": {"farther": 0.4},
        "believed": {
            "foremost": "farther",
            "rather_than": "faster",
            "rather_sure": 0.6,
            "answers": 15,
            "beyond": {
                "sure": 0.86,
                "words": [["heading_error", "less", 12], ["least_free_range_ahead", "more", 11]],
                "answers": 15,
            },
            "statement": "beyond",
        },
        "points": 5,
    },
    "meet_among_people": {
        "setup": "crowd_hall",
        "view": "top_down",
        "scenes": 3,
        "controls": CROWD_CONTROLS,
        "among_people": True,
        "start": {"waits": 1.0, "farther": 0.4},
        "believed": {
            "foremost": "waits",
            "rather_than": "slower_near_person",
            "rather_sure": 0.93,
            "answers": 15,
            "statement": "rather",
        },
        "points": 5,
    },
    "meet_your_robot": {
        "setup": "study_room",
        "view": "top_down",
        "scenes": 3,
        "controls": CONTROLS,
        "start": {"farther": 1.0},
        "believed": {
            "foremost": "farther",
            "rather_than": "faster",
            "rather_sure": 0.93,
            "answers": 15,
            "statement": "rather",
        },
        "points": 5,
    },
    "importance_ranking": {
        "role": "regular",
        "view": "immersive",
        "number": 3,
        "of": 12,
        "outline": True,
        "lidar": True,
        "things": ["couch", "table", "cupboard", "box 1", "pillar 2"],
    },
    "asking_on": {"pairs": 5, "at_most": 15, "first": True},
    "wait": {"learns_from": "paths"},
    "guess": {"learns_from": "answers"},
    "debriefing": {
        "title": "Thank you",
        "text": "That was the study.",
        "completion_code": "K7QM-2XFA",
        "about": {
            "outcome": "shown",
            "learns_from": "answers",
            "answers": 15,
            "compared": [{"against": "base", "own": 2, "pairs": 3}],
            "guessed": True,
        },
    },
    "methods_debriefing": {
        "title": "Thank you",
        "text": "That was the study.",
        "about": {
            "methods": [
                {"method": "sliders", "chosen": 5, "pairs": 6, "foremost": "farther"},
                {"method": "choices", "chosen": 3, "pairs": 6, "foremost": "smoother"},
                {"method": "words", "chosen": 3, "pairs": 6, "foremost": None},
                {"method": "drawing", "chosen": 1, "pairs": 6, "foremost": "shorter"},
            ],
            "met": [
                {"a": "words", "b": "sliders", "choice": "b", "look_alike": False},
                {"a": "choices", "b": "drawing", "choice": "a", "look_alike": True},
            ],
            "favourite": "sliders",
            "wanted": "words",
        },
    },
    "paused": {},
    "withdrawn": {"declined": False},
    "declined": {"declined": True},
    "expired": {},
}
"""Every kind of step and one example of its payload."""
KINDS = {"declined": "withdrawn", "ranking": "questionnaire", "skipping": "questionnaire", "triangle": "tuning"} | {
    "meet_something_else": "meet_your_robot",
    "meet_among_people": "meet_your_robot",
    "methods_debriefing": "debriefing",
}  # examples of a kind that has another one already


@dataclass(frozen=True)
class ExampleStep:
    """What the machine's StepView tells the templates."""

    kind: str
    key: str
    index: int
    total: int
    payload: dict[str, Any]
    minutes_left: float = 8.0
    further: bool = False
    done: float = 0.25


def example_state(kind: str, language: str = "en") -> dict[str, Any]:
    """What `GET /api/session/{token}` answers in a step of this kind."""
    trial = {"phase": "ready", "duration_a_s": 8.2, "duration_b_s": 9.6, "label_s": 2.0}
    return {
        "state": kind if kind in ("paused", "withdrawn", "expired") else "active",
        "step": {"key": f"05-{kind}", "kind": kind, "index": 5, "total": 24, "trial": trial},
        "language": language,
        "stage_url": "/static/mark.svg",  # anything that loads: the room itself is the concern of tests/app
    }


def example_application() -> FastAPI:
    templates = Jinja2Templates(FRONTEND / "templates")
    templates.env.trim_blocks = templates.env.lstrip_blocks = True
    templates.env.filters["prose"] = prose
    texts = Texts(FRONTEND / "locales")
    application = FastAPI()
    application.mount("/static", StaticFiles(directory=FRONTEND / "static"))

    def page(request: Request, template: str, language: str, **context: Any) -> Response:
        origin = str(request.base_url).rstrip("/")
        given = {"t": texts.get(language), "language": language, "stage_origin": origin, "contact": CONTACT, **context}
        response = templates.TemplateResponse(request, template, given)
        response.headers["Content-Security-Policy"] = f"default-src 'self'; frame-src {origin}; object-src 'none'"
        return response

    @application.get("/join")
    def join(request: Request, language: str = "en") -> Response:
        context = {"languages": ["en", "de"], "recruiting": {"PROLIFIC_PID": "p1"}, "action": "/join"}
        context["device"] = _gate(request)
        return page(
            request, "participant/join.html", language, study_title=TITLE, join_url="/join", asked=["block"], **context
        )

    @application.get("/device")
    def device(request: Request, language: str = "en") -> Response:
        return page(
            request, "participant/device.html", language, study_title=TITLE, action="/device", device=_gate(request)
        )

    @application.get("/refusal/{code}")
    def refusal(request: Request, code: str, language: str = "en") -> Response:
        return page(request, "participant/refusal.html", language, code=code)

    @application.get("/copy")
    def copy(request: Request, language: str = "en") -> Response:
        context = {"payload": STEPS["consent"], "given_at": WHEN, "purposes": {"training": True}, "code": "P-4F7K"}
        return page(request, "participant/consent_copy.html", language, study_title=TITLE, **context)

    @application.get("/back")
    def back(request: Request, language: str = "en") -> Response:
        return page(request, "participant/back.html", language)

    @application.get("/help")
    def help_page(request: Request, language: str = "en") -> Response:
        context = {"token": "x", "expires_at": WHEN, "looks_around": True}
        return page(request, "participant/help.html", language, study_title=TITLE, **context)

    @application.get("/step/{kind}")
    def step(request: Request, kind: str, language: str = "en") -> Response:
        shown = ExampleStep(KINDS.get(kind, kind), f"05-{kind}", 5, 24, STEPS[kind])
        context = {"token": kind, "step": shown, "state": example_state(kind, language), "expires_at": WHEN}
        context |= {"address": "https://study.example.org"}
        context |= {"payment": "You are paid for the time that you gave."}
        context |= {
            "code": "P-4F7K",
            "looks_around": True,
            "headset": None,
            "head_pose": False,
            "motor_sound": "silent",
            "longest_problem": 4000,
            "languages": ["en", "de"],
            "next_kind": "questionnaire",
        }
        context["leads_to"] = "trial"
        return page(request, "participant/session.html", language, study_title=TITLE, **context)

    @application.get("/api/session/{kind}")
    def state(kind: str) -> dict[str, Any]:
        return example_state(kind)

    @application.get("/api/session/{kind}/stream")
    def stream(kind: str) -> Response:
        return Response(status_code=204)  # tells an EventSource to stay away

    @application.post("/api/session/{kind}/steps/{key}")
    def answer(kind: str, key: str) -> dict[str, Any]:
        return {"accepted": True, "duplicate": False, **example_state(kind)}

    return application
