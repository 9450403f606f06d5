"""The line before a study's door: who knocks while others are being let in goes in with the next ones, together.

What joining means is `study/session/joining.py`'s; requests and answers are `recruiting.py`'s.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from concurrent.futures import Future
from typing import TYPE_CHECKING

from desirepath.store.database import StorageError
from desirepath.study.session.joining import Joiner, TakenIn, join_together
from desirepath.study.studies import study_by_link

if TYPE_CHECKING:
    from desirepath.store.artefacts import ArtefactStore
    from desirepath.store.database import Database

MOST_TOGETHER = 16  # ours: others who want to write wait for as many at most, some 50 ms


class Doors:
    """Lets people into studies, several of one study in one transaction where several wait.

    One alone is let in at once. Whoever is answered is on the disk, as with a transaction of their own; one commit
    waits for the disk for all of them.
    """

    def __init__(self, database: Database, files: ArtefactStore) -> None:
        self._database, self._files = database, files
        self._guard = threading.Lock()
        self._lines: dict[str, deque[tuple[Joiner, Future[TakenIn]]]] = {}  # by recruiting link, while it is worked on

    async def join(self, recruiting_token: str, who: Joiner) -> TakenIn:
        """Raises what `join_study` and the database raise, and Refused 404 for a link that leads nowhere."""
        place: Future[TakenIn] = Future()
        with self._guard:
            first = recruiting_token not in self._lines
            self._lines.setdefault(recruiting_token, deque()).append((who, place))
        if first:
            asyncio.get_running_loop().run_in_executor(None, self._work_off, recruiting_token)
        return await asyncio.wrap_future(place)

    def _work_off(self, token: str) -> None:
        while True:
            with self._guard:
                line = self._lines[token]
                if not line:
                    del self._lines[token]
                    return
                together = [line.popleft() for _ in range(min(len(line), MOST_TOGETHER))]
            self._let_in(token, together)

    def _let_in(self, token: str, together: list[tuple[Joiner, Future[TakenIn]]]) -> None:
        try:
            with self._database.transaction() as s:
                study = study_by_link(s, token)
                done = join_together(s, study, [who for who, _ in together], files=self._files)
        except Exception as problem:
            if len(together) > 1 and not isinstance(problem, StorageError):
                for one in together:  # what one of them brought and the database does not take is that one's alone
                    self._let_in(token, [one])
                return
            done = [problem] * len(together)  # type: ignore[list-item]
        for (_, place), what in zip(together, done, strict=True):
            if not place.set_running_or_notify_cancel():
                continue  # who asked is gone
            if isinstance(what, TakenIn):
                place.set_result(what)
            else:
                place.set_exception(what)
