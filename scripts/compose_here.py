"""What docker-compose.yml would start, without containers, on loopback: `make compose-here`, `make rehearse-upgrade`,
`make image-here`.

walk: start it, walk a short study through it in Chromium, export and check it, back it up and serve the backup.
upgrade: start the version of a commit, let people take part, upgrade to this one under them, count what was lost.
image: carry out the Dockerfile's steps in a folder (debootstrap, chroot), start what it says and ask for its health.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from desirepath_experiments.composed import DIFFERENT, composed
from desirepath_experiments.composed_walk import PAIRS, walk_study
from desirepath_experiments.image_here import build_here
from desirepath_experiments.upgrading import rehearse_upgrade


def walk(participants: int, pairs: int, pictures: Path | None) -> dict[str, Any]:
    """Start everything, walk a study through it, export and check it, back it up and serve that, too."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="desirepath-composed-") as folder, composed(Path(folder)) as running:
        print(f"{running.url}: {len(running.web)} web, {len(running.workers)} workers", file=sys.stderr)
        started = time.monotonic() - began
        walked = walk_study(running, participants=participants, pairs=pairs, pictures=pictures)
        return {
            "different_from_containers": DIFFERENT,
            "ready_s": round(started, 1),
            **walked,
            "seconds": round(time.monotonic() - began, 1),
        }


def image(into: Path | None) -> dict[str, Any]:
    """Carry out the Dockerfile's steps, and start what came of them."""
    with tempfile.TemporaryDirectory(prefix="desirepath-image-", ignore_cleanup_errors=True) as folder:
        made, result = build_here(into or Path(folder) / "root", tell=lambda one: print(one, file=sys.stderr))
        result |= made.says() | {"served": made.serves()}
        if into is None:
            print("the folder is removed, which takes its time; --into FOLDER keeps one", file=sys.stderr)
        return result


def main() -> int:
    """Exit code 0 where everything was walked and nothing lost."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("what", choices=["walk", "upgrade", "image"])
    asked.add_argument("--participants", type=int, default=2)
    asked.add_argument("--pairs", type=int, default=PAIRS, help="of walk: how many each participant watches")
    asked.add_argument("--old", help="commit of the version to upgrade from; default this one")
    asked.add_argument("--pictures", type=Path)
    asked.add_argument("--into", type=Path, help="an empty folder to keep the image in; default one that goes again")
    given = asked.parse_args()
    if given.what == "walk":
        result = walk(given.participants, given.pairs, given.pictures)
        restored, everybody = result["restored"], result["walked"]["completed"] == given.participants
        kept = result["lost"] == 0 and restored["answers"] == result["answers"]["stored"]
        well = everybody and kept and restored["page"] == 200
    elif given.what == "image":
        result = image(given.into)
        well = bool(result["all_well"] and result["served"]["answered"])
    else:
        result = rehearse_upgrade(given.old, people=given.participants, tell=lambda one: print(one, file=sys.stderr))
        well = result["answers_lost"] == result["half_trials"] == 0
    print(json.dumps(result, indent=1))
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
