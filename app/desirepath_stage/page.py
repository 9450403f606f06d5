"""The stage's page: viser's index.html with our style and scripts put before everything of its own.

The page posts these events to its parent window (`pageOrigin` only), each `{source: "desirepath-stage", type, ...}`:

| type | more | meaning |
|---|---|---|
| `connected`, `connection-lost` | | the websocket is up, or gone and being retried |
| `ready` | `keys` | the scene stands and has been drawn; which keys the pen and the feet take |
| `label` | `playback_id, label` | the label is shown |
| `playing` | `playback_id` | the robot starts to move |
| `played` | `playback_id, frames, duration_ms, longest_gap_ms` | watched to the end; `walk`, `headset`: how |
| `interrupted` | `playback_id, reason` | stopped before its end by `tab-hidden`, `webgl-lost`, ... |
| `tab-hidden`, `tab-visible` | | |
| `webgl-missing`, `webgl-lost`, `webgl-restored` | | |
| `replaced` | | the same stage was opened elsewhere; this one stays still |
| `key` | `key` | a key pressed while the stage had the focus (A and B, say) |
| `drawing` | `can_undo, length_m, speed, near, tight`, ... | how the stroke stands; several times a second |
| `stroke` | `id, points, speeds, times_s, pointer, walk` | a drawn path, finished: metres, m/s, s; for which walk |
| `drawn` | `id` | paths that the page sent have been drawn |
| `moved` | `poses, seconds, driving, over` | where the robots are on these paths; several times a second |
| `floor` | `place` | the floor was pressed there, where a real robot is mirrored |
| `headset` | `on, here, why, controllers, refresh_rate` | worn or not; whether it can be; what is against |
| `sound` | `on` | the sound of the motors was switched |
| `headset-press` | `id, headset` | a button of its panel was pressed, with what |
| `head` | `head` | how the head moved in a headset, a few seconds of it (`HeadMoved`) |
| `picked`, `pointed` | `thing` | an explained object was clicked; the pointer is over it, or over none (null) |
| `state` | `connected, ready, webgl, playback_id, keys` | the answer to the parent's `{type: "hello"}` |

`why` of `headset`: blocked, insecure, browser or missing: none can be worn; denied or failed: it was tried.

The parent may also send `{type: "draw", do, ...}`: words, undo, redo, clear, cut, finish, speed, problem, choose, key
to the pen (`client/draw.js`), step to the feet (`client/walk.js`), look to the camera; and `{type: "steer", do, ...}`
(`client/steer.js`): `paths` (`orders.PathsMessage`), drive, stop; and `{type: "mirror", ...}` (`orders.MirrorOrder`,
`client/mirror.js`); and `{type: "explain", ...}`:
words, ranks and which objects can be picked (`client/explained.js`); and `{type: "headset", do, ...}`: `offer` with
its words and whether `head_pose` is stored, `panel` with what stands in the room, leave (`client/headset.js`);
and `{type: "sound", words, on}` where motors may sound (`client/sound.js`).
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from desirepath_stage import viser_hooks

_CLIENT = Path(__file__).parent / "client"
_PEN = ("clearance.js", "ink.js", "sections.js", "draw.js", "walk.js")
_EXPLAINED = ("rays.js", "attention.js", "explained.js", "picking.js")
_LATER = ("steer.js", "mirror.js", *_EXPLAINED, "stage.js")
_PLACE = (
    "scheme.js",
    "overlay.js",
    "bodies.js",
    "sheet.js",
    "camera.js",
    "finder.js",
    "trail.js",
    "pictures.js",
    "sound.js",
    "player.js",
)
_WORN = ("quads.js", "headset_floor.js", "headset_room.js", "headset_hands.js", "head_pose.js", "headset.js")
_SCRIPTS = ("bridge.js", "frames.js", "viser_hooks.js", *_PLACE, *_PEN, *_WORN, *_LATER)


@dataclass(frozen=True)
class StagePage:
    """The page's bytes and their strong ETag, so that a reload need not fetch three megabytes again."""

    html: bytes
    etag: str


@lru_cache(maxsize=8)
def stage_page(page_origin: str) -> StagePage:
    """The page. page_origin: the only window that may hold it and hear from it, like "https://host:9400"."""
    config = json.dumps({"pageOrigin": page_origin}).replace("<", "\\u003c")
    head, tail = _parts()
    html = f"{head}<script>window.desirePathConfig = {config};</script>{tail}".encode()
    return StagePage(html, f'"{hashlib.sha256(html).hexdigest()[:32]}"')


@cache
def _parts() -> tuple[str, str]:
    """viser's page, cut where our configuration goes; our scripts come first, so that they run first."""
    html = viser_hooks.index_html().replace("<title>Viser</title>", "<title>Stage</title>", 1)
    before, head_tag, after = html.partition("<head>")
    if not head_tag:
        raise viser_hooks.HookError("viser's index.html has no <head> to put the stage's scripts into")
    style = (_CLIENT / "stage.css").read_text(encoding="utf-8")
    scripts = "\n".join((_CLIENT / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    return before + head_tag, f"<style>{style}</style><script>{scripts}</script>{after}"
