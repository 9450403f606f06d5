"""The job that asks a reward model as if it were a participant: `benchmark people` with one person, from the page."""

from __future__ import annotations

from typing import Any

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import find_artefact
from desirepath.jobs.kinds import AskPersonParams
from desirepath.learning.people.asked_people import PeopleConfig, benchmark_people
from desirepath.learning.people.reward_file import reward_of_store

MEASURED_AFTER = (8, 15, 50, 200)
SHOWN_AFTER = 15


def ask_person(context: JobContext, params: AskPersonParams) -> dict[str, Any]:
    """The result of `benchmark_people`. Raises ArtefactError for a reward model that may not be used, LearningError for
    one that cannot be read."""
    with context.database.session() as s:
        artefact = find_artefact(s, params.reward, "reward_model")
        setup, name, content = artefact.setup, artefact.name, context.files.get(artefact.id)
    person = reward_of_store(content, setup)
    after = tuple(sorted({n for n in MEASURED_AFTER if n < params.answers} | {params.answers}))
    config = PeopleConfig(
        families=(),
        answers=after,
        shown_after=SHOWN_AFTER if SHOWN_AFTER in after else after[0],
        seeds=(params.seed,),
        response_model=params.response_model,
        choose=params.choose,
        queries="both",
    )
    context.progress(0.1)
    return benchmark_people(setup, config, {name: person}, lambda done: context.progress(0.1 + 0.9 * done))
