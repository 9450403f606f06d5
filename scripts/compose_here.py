"""What docker-compose.yml would start, without containers, on loopback: `make compose-here`, `make rehearse-upgrade`.

walk: start it, walk simulated participants through a study in Chromium, make a backup on the store of files, stop.
upgrade: start the version of a commit, let people take part, upgrade to this one under them, count what was lost.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from backend.experiments.composed import DIFFERENT, composed
from backend.experiments.upgrading import open_study, rehearse_upgrade, store_in_environment


def walk(participants: int, pictures: Path | None) -> dict[str, object]:
    """Start everything, walk a study through it, back it up."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="desirepath-composed-") as folder, composed(Path(folder)) as running:
        print(f"{running.url}: {len(running.web)} web, {len(running.workers)} workers", file=sys.stderr)
        started = time.monotonic() - began
        with store_in_environment(running):
            study, _ = open_study(running)
        desirepath = [sys.executable, "-m", "backend.cli"]
        count = str(participants)
        walking = [*desirepath, "study", "simulate", study, "--participants", count, "--browser", "1"]
        if pictures is not None:
            walking += ["--pictures", str(pictures)]
        walking += ["--url", running.url, "--json"]
        walked = subprocess.run(walking, env=running.environment, stdout=subprocess.PIPE)
        saving = [*desirepath, "backup", "--out", "s3://desirepath/backups/walked.tar", "--json"]
        saved = subprocess.run(saving, env=running.environment, stdout=subprocess.PIPE)
        return {
            "different_from_containers": DIFFERENT,
            "ready_s": round(started, 1),
            "walked": json.loads(walked.stdout) if walked.returncode == 0 else "failed",
            "backup": json.loads(saved.stdout) if saved.returncode == 0 else "failed",
        }


def main() -> int:
    """Exit code 0 where everything was walked and nothing lost."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("what", choices=["walk", "upgrade"])
    asked.add_argument("--participants", type=int, default=2)
    asked.add_argument("--old", help="commit of the version to upgrade from; default this one")
    asked.add_argument("--pictures", type=Path)
    given = asked.parse_args()
    if given.what == "walk":
        result = walk(given.participants, given.pictures)
        well = "failed" not in (result["walked"], result["backup"])
    else:
        result = rehearse_upgrade(given.old, people=given.participants, tell=lambda one: print(one, file=sys.stderr))
        well = result["answers_lost"] == result["half_trials"] == 0
    print(json.dumps(result, indent=1))
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
