"""`desirepath policies flow-field|trajectories|explain`: how policies behave and why, as figures with their numbers."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from desirepath.cli.output import JsonFlag, in_data_folder, say, takes_long
from desirepath.cli.science import find_policy

if TYPE_CHECKING:
    from desirepath.explain.flow_files import FigureFiles
    from desirepath.learning.policies.policy import DrivingPolicy
    from desirepath.simulation.scene import Scene

SetupFlag = Annotated[str | None, typer.Option(help="Name of a setup; by default the policy's own.")]
SceneFlag = Annotated[
    int | None, typer.Option(help="Seed of the scene; by default the first one kept for figures (3500000000).")
]
FolderFlag = Annotated[Path, typer.Option(help="Folder for the files; made if missing, same names replaced.")]


def register(policies: typer.Typer) -> None:
    """Add this module's commands to `desirepath policies`."""
    policies.command("flow-field")(flow_field)
    policies.command()(trajectories)
    policies.command()(explain)


@in_data_folder
@takes_long("drawing where {policy} heads from everywhere")
def flow_field(
    policy: Annotated[str, typer.Argument(help="Id, path, or a shipped name such as study_room/base.")],
    policy_b: Annotated[str | None, typer.Argument(help="A second policy, shown beside with the difference.")] = None,
    setup: SetupFlag = None,
    scene: SceneFlag = None,
    cell: Annotated[float, typer.Option(help="Side of a grid cell, m.")] = 0.25,
    out: FolderFlag = Path("flow_field"),
    as_json: JsonFlag = False,
) -> None:
    """Draw where a policy heads from everywhere in a scene (PNG, SVG, CSV)."""
    from desirepath.explain.flow_files import flow_files
    from desirepath.simulation.setups import get_setup

    named = {name: find_policy(name) for name in (policy, policy_b) if name is not None}
    if policy_b == policy:
        raise ValueError(f"policy_b = {policy_b!r}: is the same policy; give another one, or none")
    shown = _scene(named, setup, scene)
    acts = [(_title(name), one.in_scene(shown).rollout_policy) for name, one in named.items()]
    made = flow_files(acts, get_setup(shown.setup), shown, cell_m=cell)
    say({**made.numbers, "files": _written(made, out)}, as_json)


@in_data_folder
@takes_long("drawing how the policies drive")
def trajectories(
    policies: Annotated[list[str], typer.Argument(help="Ids, paths or shipped names, e.g. all of an ensemble.")],
    setup: SetupFlag = None,
    scene: SceneFlag = None,
    starts: Annotated[int, typer.Option(min=1, help="Starts: the scene's own, then far from each other.")] = 6,
    out: FolderFlag = Path("trajectories"),
    as_json: JsonFlag = False,
) -> None:
    """Draw how several policies drive from several starts in one scene (PNG, SVG, CSV)."""
    from desirepath.explain.flow_files import starts_files
    from desirepath.simulation.setups import get_setup

    named = {name: find_policy(name) for name in policies}
    shown = _scene(named, setup, scene)
    acts = {_title(name): one.rollout_policy for name, one in named.items()}
    made = starts_files(acts, get_setup(shown.setup), shown, starts=starts)
    say({**made.numbers, "files": _written(made, out)}, as_json)


@in_data_folder
@takes_long("explaining {policy}")
def explain(
    policy: Annotated[str, typer.Argument(help="Id, path, or a shipped name such as study_room/base.")],
    scene: SceneFlag = None,
    method: Annotated[
        str, typer.Option(help="integrated_gradients, saliency or smooth_grad.")
    ] = "integrated_gradients",
    command: Annotated[str, typer.Option(help="What is explained: speed or turning.")] = "speed",
    at: Annotated[
        float | None, typer.Option(help="Moment of the picture, s; by default where it slowed down or turned most.")
    ] = None,
    out: FolderFlag = Path("explanation"),
    as_json: JsonFlag = False,
) -> None:
    """Draw how much each thing moved a policy's command (PNG, SVG, CSV).

    Of one with attention, at whom it looked.
    """
    from desirepath.web.core.explained_policy import explain_policy

    explained = find_policy(policy)
    shown = _scene({policy: explained}, None, scene)
    made = explain_policy(explained, shown, name=_title(policy), method=method, command=command, at_s=at)
    say({**made.numbers, "files": _written(made, out)}, as_json)


def _scene(named: dict[str, DrivingPolicy], setup: str | None, seed: int | None) -> Scene:
    from desirepath.learning.scene_sets import Purpose, first_seed
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import require_same

    asked = {"--setup": setup} if setup is not None else {}
    name = require_same(**asked, **{reference: policy.setup for reference, policy in named.items()})
    return draw_scene(name, first_seed(Purpose.FIGURE, 0) if seed is None else seed)


def _title(reference: str) -> str:
    """A policy's name in a figure: an id is cut short, a path shows its file."""
    if len(reference) == 64:
        return reference[:12]
    return Path(reference).name if Path(reference).is_file() else reference


def _written(made: FigureFiles, out: Path) -> list[dict[str, Any]]:
    out.mkdir(parents=True, exist_ok=True)
    listed = []
    for name, content in made.files.items():
        (out / name).write_bytes(content)
        listed.append({"path": str(out / name), "sha256": hashlib.sha256(content).hexdigest()})
    return listed
