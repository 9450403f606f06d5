"""`desirepath policies ...`: policies of others come in, ours go out, all are listed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say, takes_long
from desirepath.cli.science import policy_file
from desirepath.cli.study import open_store

if TYPE_CHECKING:
    from desirepath.store.models import Artefact

commands = typer.Typer(help="Policies: what drives a robot.", no_args_is_help=True)


@commands.command("import")
@in_data_folder
@takes_long("reading {file}")
def import_(
    file: Annotated[
        Path, typer.Argument(help="ONNX with a manifest, a zip of Stable-Baselines3, or our own file (.npz).")
    ],
    name: Annotated[str, typer.Option(help="What it is called; default the file's name.")] = "",
    setup: Annotated[str, typer.Option(help="Whose robot it drives; default what its manifest says.")] = "",
    manifest: Annotated[Path | None, typer.Option(help="Manifest (JSON), where the file holds none.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Keep a policy of yours, to evaluate, compare, explain and ask about it."""
    from desirepath.learning.errors import LearningError
    from desirepath.learning.policies.importing import FILE_BYTES, import_policy
    from desirepath.learning.policies.manifest import MANIFEST_BYTES
    from desirepath.store.audit import record
    from desirepath.store.imported_policies import save_imported_policy
    from desirepath.store.models import utc_now
    from desirepath.store.shipped_policies import register_shipped

    def read(path: Path, most: int) -> bytes:
        if (size := path.stat().st_size) > most:
            raise LearningError(f"{path}: {size:,} bytes; at most {most:,} are read")
        return path.read_bytes()

    beside = read(manifest, MANIFEST_BYTES) if manifest is not None else None
    found = import_policy(
        read(file, FILE_BYTES), file.name, setup=setup, manifest=beside, manifest_named=str(manifest or "")
    )
    database, files = open_store(makes=True)
    with database.transaction() as s:
        register_shipped(s, files)
        kept, new = save_imported_policy(s, files, found, name=name, by=COMMAND_LINE, now=utc_now())
        record(s, "policy_taken_in", by=COMMAND_LINE, artefact_id=kept.id, file_sha256=found.sha256)
        result = {"policy": kept.id, "setup": kept.setup, "name": kept.name, "new": new, "notes": list(found.notes)}
    say(result, as_json)


@commands.command()
@in_data_folder
@takes_long("writing {policy}")
def export(
    policy: Annotated[
        str, typer.Argument(help="Id, path, or a shipped name: study_room/base, study_room/conditioned@farther=1.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for its files.")],
    as_json: JsonFlag = False,
) -> None:
    """Write a policy's files: a bundle that drives a robot, ONNX, Stable-Baselines3 zip.

    The bundle holds our own file, manifest, test vectors and the program. What cannot be had is named under `left_out`.
    """
    from desirepath.deploy.manifest import BundleError
    from desirepath.learning.errors import LearningError
    from desirepath.learning.policies.bundles import VECTORS, bundle_files
    from desirepath.learning.policies.export import policy_to_onnx, policy_to_sb3_zip
    from desirepath.learning.policies.policy import read_policy
    from desirepath.simulation.setups import SetupError

    stored, weights = read_policy(policy_file(policy)), policy.partition("@")[2]
    driving = stored.driving(weights)
    written = {"policy.npz": (driving if weights else stored).to_bytes()}
    written["manifest.json"] = json.dumps(driving.manifest(), indent=2, sort_keys=True).encode()
    left_out: dict[str, str] = {}
    for file, write in (("policy.onnx", policy_to_onnx), ("policy.zip", policy_to_sb3_zip)):
        try:
            written[file] = write(driving)
        except LearningError as problem:
            left_out[file] = str(problem)
    try:
        written |= bundle_files(stored, weights)
    except (LearningError, SetupError, BundleError) as problem:
        left_out[VECTORS] = str(problem)
    for file, content in written.items():
        (out / file).parent.mkdir(parents=True, exist_ok=True)
        (out / file).write_bytes(content)
    say({"files": [str(out / file) for file in written], "left_out": left_out}, as_json)


@commands.command("list")
@in_data_folder
def list_(as_json: JsonFlag = False) -> None:
    """List the policies of this installation: imported, made by jobs, shipped."""
    from sqlalchemy import select

    from desirepath.jobs.kinds import ANY_POLICY
    from desirepath.store.models import Artefact
    from desirepath.store.shipped_policies import register_shipped

    database, files = open_store()
    with database.transaction() as s:
        register_shipped(s, files)
        kinds = Artefact.kind.in_(ANY_POLICY.split("|"))
        rows = s.scalars(select(Artefact).where(kinds).order_by(Artefact.created_at.desc(), Artefact.name))
        say({"policies": [_row(artefact) for artefact in rows]}, as_json)


@commands.command()
@in_data_folder
def show(
    policy: Annotated[str, typer.Argument(help="Id, or a shipped name.")],
    as_json: JsonFlag = False,
) -> None:
    """Show a policy's card."""
    from desirepath.jobs.kinds import ANY_POLICY
    from desirepath.store.shipped_policies import find_artefact, register_shipped

    database, files = open_store()
    with database.transaction() as s:
        register_shipped(s, files)
        found = find_artefact(s, policy)
        if found is None or found.kind not in ANY_POLICY.split("|"):
            raise LookupError(f"no policy {policy!r}: `desirepath policies list` has ids and names")
        card = {name: found.card.get(name) for name in ("imported", "notes", "parents", "command", "results")}
        say(_row(found) | card, as_json)


def _row(artefact: Artefact) -> dict[str, Any]:
    origin = "imported" if artefact.card.get("imported") else "job" if artefact.job_id else "shipped"
    return {
        "id": artefact.id,
        "name": artefact.name,
        "kind": artefact.kind,
        "setup": artefact.setup,
        "from": origin,
        "usable": artefact.quarantined_at is None,
    }
