"""`desirepath reproduce demonstrations`, without the command line: estimate, work, figures, report. It reads clocks."""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from backend.demonstrations.td3_bc import DEPARTURES, DemonstrationConfig
from backend.learning.artefacts import Card, card_path, file_sha256, source_commit
from backend.reproduction.demonstrations import FUNCTIONS, Budget, make_plan
from backend.reproduction.demonstrations_results import BARS, rows_of
from backend.reproduction.pieces import Piece, Run, Work, finish, in_order
from backend.reproduction.run import Tell, estimate, plain, told_time


def reproduce_demonstrations(
    out: Path, budget: Budget, *, processes: int = 2, command: str = "", tell: Tell = lambda words: None
) -> dict[str, Any]:
    """Compute what is missing under `out`/work, then write figures, results.json with its card, and report.html.

    Stopped in any way and started again, it goes on with the first piece that is not stored. Raises RuntimeError if
    another run works in the same folder.
    """
    from backend.reproduction.demonstrations_figures import pictures  # matplotlib is slow to load
    from backend.reproduction.demonstrations_report import brief, write_report

    # numba and BLAS read these when a process begins; pieces are computed one thread each
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    plan = make_plan(budget)
    work = Work(out / "work")
    began = time.perf_counter()
    with work.claimed():
        tell(estimate(plan.pieces(), work).in_words(processes))

        def told(piece: Piece, done: int, todo: int, left: float) -> None:
            whose = piece.params.get("style", piece.params.get("controller", ""))
            what = f"{piece.kind}, {whose} in the {piece.params['environment']}"
            tell(f"[{done}/{todo}] {what}; about {told_time(left)} left")

        computed = finish(plan.pieces(), FUNCTIONS, work, processes=processes, on_piece=told)
        rows = rows_of(plan, work.load)
        tell("drawing")
        drawn = pictures(plan, work.load)
        files = [path for picture in drawn for path in picture.save(out / "figures")]
        made = {piece.key: work.load(piece.key).meta["made"] for piece in in_order(plan.pieces())}
        run = Run(command, source_commit(), processes, time.perf_counter() - began, computed, made)
        write_report(out / "report.html", plan, rows, work.load, drawn, run)
        told_briefly = brief(plan, rows, work.load)
        results = out / "results.json"
        summary = {
            "command": command,
            "commit": run.commit,
            "budget": asdict(budget),
            "processes": processes,
            "seconds": run.seconds,
            "computed": computed,
            "core_seconds": run.core_seconds,
            "simulated": True,
            "bars": {name: asdict(bar) for name, bar in BARS.items()},
            "rows": [asdict(row) for row in rows],
            "brief": told_briefly,
            "pieces": made,
        }
        results.write_text(json.dumps(plain(summary), indent=1) + "\n", encoding="utf-8")
        card = Card(
            kind="reproduction",
            name=f"demonstrations/reproduce_{budget.name}",
            setup=", ".join(budget.environments),
            file=results.name,
            sha256=file_sha256(results),
            command=command,
            seed=budget.seeds[0],
            commit=run.commit,
            config={**asdict(budget), "training": DemonstrationConfig(updates=budget.updates).as_dict()},
            scenes={"unseen": f"reporting scenes of seeds {', '.join(map(str, budget.seeds))}"},
            results={"brief": told_briefly, "core_seconds": run.core_seconds},
            departures=DEPARTURES,
            notes=["Simulated throughout: those who demonstrate are programmed demonstrators."],
        )
        card.save(card_path(results))
    return {
        "report": str(out / "report.html"),
        "results": str(results),
        "figures": [str(path) for path in files],
        **{key: summary[key] for key in ("budget", "seconds", "computed", "core_seconds", "commit", "brief")},
    }
