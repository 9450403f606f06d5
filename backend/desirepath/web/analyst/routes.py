"""The analysts' pages under /lab: jobs, snapshots, policies, compare, flow field, drawn paths.

The routes live in the modules named here.
"""

from __future__ import annotations

from fastapi import APIRouter

from desirepath.web.analyst import (
    artefact_pages,
    attention_pages,
    compare_pages,
    demonstration_pages,
    explanation_pages,
    flow_pages,
    job_curves,
    job_pages,
    live_pages,
    reward_files,
    upkeep_pages,
)

router = APIRouter()
for part in (
    job_curves,
    job_pages,
    artefact_pages,
    compare_pages,
    flow_pages,
    explanation_pages,
    live_pages,
    attention_pages,
    demonstration_pages,
    reward_files,
    upkeep_pages,
):
    router.include_router(part.router)
