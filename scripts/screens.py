"""Pictures of every page of a running demo with the example study, in both languages and schemes and at three widths.

The lab's pages are found by following their links, one of every kind; a simulated participant walks the demo study over
HTTP, with --every also a study of every shipped protocol, and every new kind of step is looked at on the way. Contact
sheets put all pages of a combination side by side.
.venv/bin/python scripts/screens.py FOLDER [--every] [--only PART ...] [--languages en de] [--widths 1440 1024 390]

With --manual in place of a folder it makes the pictures that the manual shows, in docs/images.
"""

from __future__ import annotations

import argparse
import io
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urljoin, urlsplit

import httpx
from PIL import Image, ImageDraw
from sqlalchemy import select

from desirepath.cli import loopback
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.example_study import example_id
from desirepath.store.models import Study
from desirepath.study.protocol.freezing import find_shipped_protocols, freeze
from desirepath.study.simulated.http import HttpSessionClient
from desirepath.study.simulated.participant import Character, walk_all
from desirepath.study.studies import create_study
from desirepath.web.core.opening_link import link_path
from desirepath_experiments.browser.client import chromium

LANGUAGES, SCHEMES = ("en", "de"), ("light", "dark")
HEIGHTS = {1440: 900, 1024: 640, 390: 844}  # of the window, by its width
LONGEST = 2.5  # how many windows high a picture may be
STAGE_S, STILL_S = 6.0, 0.4  # what the 3D stage gets to draw itself, and everything else
THUMB, ACROSS = 300, 8
ID = re.compile(r"[0-9a-f-]{8,}|[A-Z]+-?\w+|\d+")
FILE = re.compile(r"\.\w{2,5}$|/content$")
LINK = re.compile(r'href="([^"#]+)')
PASSED_BY = ("/lab/sign-out", "/lab/language", "/lab/sign-in/", "/preview/", "/revise")
ALIKE = ("guides", "new")  # folders of whose pages one is enough
EXAMPLE_S = 300.0
loopback.START_PATIENCE_S = EXAMPLE_S  # pictures can wait, on a busy machine too
MANUAL = Path(__file__).resolve().parents[1] / "docs/images"
MANUAL_WINDOW, MANUAL_SIZE = (1280, 800), (800, 500)
MANUAL_BYTES, MANUAL_QUALITIES = 16_000, (36, 30, 24)
MANUAL_PAGES = {  # of the lab: by name, the address below /lab
    "studies": "studies",
    "monitor": "studies/{example}/now",
    "report": "studies/{example}/report",
    "policies": "policies",
}
MANUAL_STEPS = ("trial", "meet_your_robot")


@dataclass(frozen=True)
class Demo:
    """A running demo. cookies: of a browser that is signed in; join: the demo study's link; example: the study's id;
    more: links of studies of the shipped protocols."""

    url: str
    cookies: Mapping[str, str]
    join: str
    example: str
    more: Sequence[str] = ()


@contextmanager
def running_demo(data: Path, *, every: bool = False) -> Iterator[Demo]:
    """`desirepath serve --demo` in a new folder, once the example study is there."""
    settings = Settings(data=data, _env_file=None)
    with (
        loopback.loopback_server(settings, arguments=("--demo",)) as (url, _),
        httpx.Client(base_url=url, timeout=60) as client,
    ):
        database, deadline = Database(settings.database), time.monotonic() + EXAMPLE_S
        while True:
            with database.session() as s:
                example = example_id(s)
            if example is not None or time.monotonic() > deadline:
                break
            time.sleep(0.5)
        if example is None:
            raise SystemExit(f"the example study was not there after {EXAMPLE_S:.0f} s")
        with database.transaction() as s:
            once = link_path(s, settings)
            recruiting = s.scalars(select(Study.recruiting_token).where(Study.id != example)).one()
        more = []
        for file in find_shipped_protocols() if every else ():
            with database.transaction() as s:
                study = create_study(
                    s, ArtefactStore(settings.artefacts), freeze(file), name=file.stem, created_by=None
                )
                more.append(study.recruiting_token)
        database.close()
        client.get(str(once))
        yield Demo(url, dict(client.cookies), recruiting, example, more)


def find_pages(demo: Demo) -> dict[str, str]:
    """Name -> address of one of every kind of page of the lab."""
    study = f"/lab/studies/{demo.example}"
    waiting, found, seen = (
        ["/lab/studies", f"{study}/now", f"{study}/people", "/lab/policies", "/lab/jobs", "/lab/sign-in"],
        {},
        set(),
    )
    with httpx.Client(base_url=demo.url, timeout=60, cookies=dict(demo.cookies)) as client:
        while waiting:
            path = waiting.pop(0)
            parts = path.strip("/").split("/")[1:]
            name = "_".join(
                "ID" if k and (ID.fullmatch(part) or parts[k - 1] in ALIKE) else part for k, part in enumerate(parts)
            )
            if name in seen or FILE.search(path) or any(word in path for word in PASSED_BY):
                continue
            seen.add(name)
            began = time.monotonic()
            try:
                answered = client.get(path)
            except httpx.TimeoutException:
                print(f"{path}: no answer", file=sys.stderr, flush=True)
                continue
            finally:
                if (took := time.monotonic() - began) > 2:
                    print(f"{path}: {took:.1f} s", file=sys.stderr, flush=True)
            if answered.status_code != 200 or "text/html" not in answered.headers.get("content-type", ""):
                continue
            found[name] = path
            links = [urlsplit(urljoin(path, link)) for link in LINK.findall(answered.text)]
            ours = [link.path for link in links if not link.netloc and link.path.startswith("/lab")]
            waiting += sorted(ours, key=lambda link: demo.example not in link)
    return found


class Camera:
    """Takes one page's pictures in a scheme at all widths."""

    def __init__(self, folder: Path, widths: Sequence[int]) -> None:
        self._folder, self._widths = folder, widths
        self.taken = 0

    def has(self, name: str, language: str, scheme: str) -> bool:
        """Whether an earlier run that was cut off took them."""
        return all((self._folder / f"{language}-{scheme}-{width}" / f"{name}.webp").exists() for width in self._widths)

    def look(self, page: Any, name: str, language: str, scheme: str) -> None:
        for width in self._widths:
            page.set_viewport_size({"width": width, "height": HEIGHTS[width]})
            page.wait_for_timeout(1000 * STILL_S)
            shot = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
            whole = shot.crop((0, 0, shot.width, min(shot.height, round(LONGEST * HEIGHTS[width]))))
            place = self._folder / f"{language}-{scheme}-{width}"
            place.mkdir(parents=True, exist_ok=True)
            whole.save(place / f"{name}.webp", quality=80)
            self.taken += 1


def settle(page: Any) -> None:
    """Wait for what a page draws after it has come."""
    page.wait_for_load_state("load")
    page.wait_for_timeout(1000 * (STAGE_S if page.locator("iframe").count() else STILL_S))


def show_lab(browser: Any, demo: Demo, camera: Camera, pages: Mapping[str, str], languages: Sequence[str]) -> None:
    for language in languages:
        for scheme in SCHEMES:
            context = browser.new_context(color_scheme=scheme, locale=language)
            context.add_cookies([{"name": key, "value": value, "url": demo.url} for key, value in demo.cookies.items()])
            page = context.new_page()
            page.goto(f"{demo.url}/lab/language/{language}?next=/lab/studies")
            for name, path in pages.items():
                if camera.has(name, language, scheme):
                    continue
                page.set_viewport_size({"width": 1440, "height": HEIGHTS[1440]})
                try:
                    page.goto(f"{demo.url}{path}")
                    settle(page)
                    camera.look(page, name, language, scheme)
                except Exception as problem:
                    print(f"{name}: {problem}"[:300], file=sys.stderr)
            context.close()
            print(f"lab {language} {scheme}: {camera.taken} pictures", file=sys.stderr, flush=True)


def take_manual(browser: Any, demo: Demo, only: Sequence[str]) -> None:
    """The manual's pictures, in both schemes; of those named alone, where some are."""

    def take(page: Any, name: str, scheme: str) -> None:
        shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB").resize(MANUAL_SIZE, Image.Resampling.LANCZOS)
        out = MANUAL / f"{name}-{scheme}.webp"
        for quality in MANUAL_QUALITIES:
            shot.save(out, quality=quality, method=6)
            if out.stat().st_size <= MANUAL_BYTES:
                break
        print(f"{out}: {out.stat().st_size:,} bytes", file=sys.stderr, flush=True)

    def opened(scheme: str, path: str, cookies: Mapping[str, str]) -> Any:
        width, height = MANUAL_WINDOW
        context = browser.new_context(
            color_scheme=scheme, locale="en", viewport={"width": width, "height": height}, timezone_id="Europe/Berlin"
        )
        context.add_cookies([{"name": key, "value": value, "url": demo.url} for key, value in cookies.items()])
        page = context.new_page()
        page.goto(f"{demo.url}{path}")
        settle(page)
        page.wait_for_timeout(1000 * STAGE_S)
        return page

    for scheme in SCHEMES:
        for name, path in MANUAL_PAGES.items():
            if only and name not in only:
                continue
            page = opened(scheme, f"/lab/{path.format(example=demo.example)}", demo.cookies)
            take(page, name, scheme)
            page.context.close()

    def look(name: str, path: str) -> None:
        kind = name.split("-", 2)[2]
        for scheme in SCHEMES if kind in MANUAL_STEPS and (not only or kind in only) else ():
            page = opened(scheme, path, {})
            if kind == "trial":
                page.locator("#start[aria-disabled=false]").wait_for(timeout=1000 * EXAMPLE_S)
                page.wait_for_timeout(1000 * STAGE_S)
            take(page, kind.replace("_", "-"), scheme)
            page.context.close()

    with httpx.Client(base_url=demo.url, timeout=120) as client:
        walk_all([LookedAtClient(client, demo.join, "en", look, set())], Character())


class LookedAtClient(HttpSessionClient):
    """A simulated participant over HTTP; the first step of every kind, and trial of every view, that is not in `shown`
    is shown to `look` before it is answered."""

    def __init__(
        self, client: httpx.Client, link: str, language: str, look: Callable[[str, str], None], shown: set[str]
    ) -> None:
        super().__init__(client, link, language)
        self._look, self._shown = look, shown

    def state(self) -> Any:
        state = super().state()
        step = state["step"] or {"kind": state["state"]}
        kind = step["kind"] if step["kind"] != "trial" or step["view"] == "top_down" else f"trial_{step['view']}"
        if kind not in self._shown:
            self._shown.add(kind)
            self._look(f"step-{len(self._shown):02d}-{kind}", f"/p/{self.token}")
        return state

    def submit(self, key: str, value: Mapping[str, Any]) -> Any:
        super().submit(key, value)
        return {"duplicate": False, **self.state()}


def show_steps(browser: Any, demo: Demo, camera: Camera, languages: Sequence[str]) -> None:
    for language in languages:

        def look(name: str, path: str, language: str = language) -> None:
            for scheme in SCHEMES:
                context = browser.new_context(
                    viewport={"width": 1440, "height": 900}, color_scheme=scheme, locale=language
                )
                page = context.new_page()
                try:
                    page.goto(f"{demo.url}{path}")
                    settle(page)
                    camera.look(page, name, language, scheme)
                except Exception as problem:
                    print(f"{name}: {problem}"[:300], file=sys.stderr)
                context.close()

        look("join", f"/join/{demo.join}?lang={language}")
        with httpx.Client(base_url=demo.url, timeout=120) as client:
            shown = set[str]()
            for link in (*demo.more, demo.join):
                walker = LookedAtClient(client, link, language, look, shown)
                walk_all([walker], Character(), lambda line: print(line, file=sys.stderr, flush=True))
            look("help", f"/p/{walker.token}/help")
            look("consent-copy", f"/p/{walker.token}/consent")


def write_sheets(folder: Path) -> list[Path]:
    """A contact sheet for every combination."""
    sheets = []
    for place in sorted(one for one in folder.iterdir() if one.is_dir()):
        pictures = sorted(place.glob("*.webp"))
        width = THUMB if not place.name.endswith("-390") else THUMB // 2
        height = round(width * (1.1 if width == THUMB else 2.4))
        across = ACROSS * THUMB // width
        rows = -(-len(pictures) // across)
        sheet = Image.new("RGB", (across * (width + 8), rows * (height + 22)), "#888")
        draw = ImageDraw.Draw(sheet)
        for number, picture in enumerate(pictures):
            x, y = number % across * (width + 8), number // across * (height + 22)
            shot = Image.open(picture)
            shot = shot.resize((width, max(1, shot.height * width // shot.width)), Image.Resampling.LANCZOS)
            sheet.paste(shot.crop((0, 0, width, min(height, shot.height))), (x, y + 18))
            draw.text((x + 2, y + 3), picture.stem[: width // 6], "#fff")
        sheets.append(folder / f"sheet-{place.name}.webp")
        sheet.save(sheets[-1], quality=75)
    return sheets


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", default=MANUAL)
    parser.add_argument("--manual", action="store_true", help="the manual's pictures alone")
    parser.add_argument("--only", nargs="*", default=[], help="pages whose name holds one of these; 'steps': all steps")
    parser.add_argument("--every", action="store_true", help="steps of every shipped protocol, not the demo's alone")
    parser.add_argument("--lab", action="store_true", help="the lab's pages alone")
    parser.add_argument("--languages", nargs="*", default=LANGUAGES)
    parser.add_argument("--widths", nargs="*", type=int, default=list(HEIGHTS))
    asked = parser.parse_args()
    if asked.manual == (asked.folder != MANUAL):
        parser.error("either a folder or --manual")
    with (
        tempfile.TemporaryDirectory() as data,
        running_demo(Path(data), every=asked.every) as demo,
        chromium() as browser,
    ):
        camera = Camera(asked.folder, asked.widths)
        if asked.manual:
            take_manual(browser, demo, asked.only)
            return
        pages = find_pages(demo)
        print(f"{len(pages)} pages: {' '.join(pages)}", file=sys.stderr, flush=True)
        if "steps" in asked.only or (not asked.only and not asked.lab):
            show_steps(browser, demo, camera, asked.languages)
        wanted = {n: p for n, p in pages.items() if not asked.only or any(part in n for part in asked.only)}
        show_lab(browser, demo, camera, wanted, asked.languages)
    for sheet in write_sheets(asked.folder):
        print(sheet)


if __name__ == "__main__":
    main()
