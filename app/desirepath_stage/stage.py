"""One stage: what one browser connection sees. Shows scenes, plays trajectories, lets paths be drawn; knows no
study and no trial.

Playback itself runs in the page (`client/player.js`); the page tells its parent window when a trajectory has been
watched to its end. Nothing that is sent there names a policy or a participant, and a goal only where it is to be seen.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import viser

from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Floats, Trajectory
from desirepath_stage import bodies, explained_nodes, scene_nodes, viser_hooks
from desirepath_stage.camera_pictures import CameraPictures
from desirepath_stage.orders import Order
from desirepath_stage.paper import Beside, Paper, crowd_tracks, pose_track, surroundings, walk_track
from desirepath_stage.shapes import Colour
from desirepath_stage.views import Frame, View, camera_for, holds, require_view

GET_SET_S = 3.0  # ours: who walks beside a rollout sees where they are before the robot moves
SHARPNESS = {"full": 1.0, "light": 0.6}  # ours: pixels drawn per pixel of the screen, in each direction
DRIVEN_PATH_M = 0.03  # ours: above the floor, over the paths that lie beside it
HOLD_S = 0.6  # ours: the end stays in sight before the next thing happens


@dataclass(frozen=True)
class _Showing:
    scene: Scene
    view: View
    frame: Frame
    robots: tuple[bodies.RobotColours, ...]
    goal: bool = False
    explained: ShownExplanation | None = None


class Stage:
    """The stage of one connection. Methods may be called from any thread and return at once."""

    def __init__(self, key: str, client: viser.ClientHandle, close: Callable[[], None]) -> None:
        """key: what the connection's path said. close: drops the connection."""
        self.key = key
        self.detail: scene_nodes.Detail = "full"  # of every scene shown from now on
        self._client = client
        client.scene.configure_default_lights(False, cast_shadow=False)  # light is baked into the colours
        client.scene.configure_environment_map(None)
        self._close = close
        self._lock = threading.RLock()
        self._showing: _Showing | None = None
        self._nodes = scene_nodes.Nodes((), ())
        self._shown = 0
        self._gone = False

    def show(
        self,
        scene: Scene,
        view: View,
        *,
        trajectories: Sequence[Trajectory] = (),
        goal: bool = False,
        explained: ShownExplanation | None = None,
        halted: bool = False,
    ) -> None:
        """Build the scene with the robot at its start. The page posts `ready` when all of it can be seen.

        trajectories: everything that will be played in this scene; give A and B together, so that the view from
        above is framed once for both, closely. goal: it stands there and a trail fades behind the robot; reasons show
        it anyway.
        explained: what is shown of the reasons of the one that will be played, in the whole room; halted: it was, so
        the robot stands at its end. Raises ViewError for an unknown view.
        """
        end = trajectories[0].poses[-1] if halted and trajectories else None
        goal = goal and explained is None
        close = bool(trajectories) and explained is None
        self._show(
            scene,
            require_view(view),
            trajectories,
            (bodies.NEUTRAL,),
            goal=goal,
            close=close,
            explained=explained,
            end=end,
        )

    def draw(self, scene: Scene, view: View, paper: Paper) -> None:
        """Show the scene with its goal and let a path be drawn from the robot; the page posts `drawing` and `stroke`.

        Raises ViewError for an unknown view.
        """
        with self._lock:
            self._show(scene, require_view(view), (), (bodies.NEUTRAL,), goal=True)
            self._run({"type": "draw", **paper.as_message(scene, view)})

    def live(
        self,
        scene: Scene,
        view: View,
        *,
        trajectories: Sequence[Trajectory] = (),
        robots: Literal[1, 2] = 1,
        around_m: float = 0.0,
    ) -> None:
        """Show the scene with its goal for paths that the page sends itself (`client/steer.js`).

        trajectories: what the robot may do, so that the view from above is wide enough. robots: two are told apart by
        colour. around_m: as for `camera_for`. Raises ViewError for an unknown view.
        """
        colours = (bodies.NEUTRAL,) if robots == 1 else (bodies.LEFT, bodies.RIGHT)
        self._show(scene, require_view(view), trajectories, colours, goal=True, around_m=around_m)

    def several(self, view: View, trajectories: Sequence[Trajectory], colours: Sequence[Colour]) -> None:
        """Show the ways of all of them on the floor, numbered, in the first one's scene; the page says which one the
        robot drives (`client/steer.js`). Raises ViewError for an unknown view.
        """
        scene = trajectories[0].scene
        with self._lock:
            self._show(scene, require_view(view), trajectories, (bodies.NEUTRAL,), goal=True, close=True)
            self._run(
                {
                    "type": "steer",
                    "do": "paths",
                    "id": "several",
                    "onward": False,
                    "numbered": True,
                    "paths": [
                        {
                            "track": pose_track(one.times, one.poses),
                            "colour": list(colour),
                            "hollow": False,
                            "arrives": True,
                        }
                        for one, colour in zip(trajectories, colours, strict=False)
                    ],
                    "person": walk_track(scene),
                }
            )

    def play(
        self,
        trajectory: Trajectory,
        *,
        label: str,
        view: View,
        playback_id: str,
        label_s: float = 0.0,
        trajectories: Sequence[Trajectory] = (),
        goal: bool = False,
        walking: bool = False,
        paper: Paper | None = None,
        explained: ShownExplanation | None = None,
    ) -> None:
        """Show the label, then the motion at its own speed; the page posts `played` with this `playback_id`.

        Builds the scene first when another one stands there, or one whose frame is too small for this trajectory.
        label: "A", "B", or "" for none; it stands for `label_s` seconds before the robot moves. trajectories: as for
        `show`. goal: as for `show`.
        The scene's person walks as its walk says; walking: the participant does, and `played` brings their `walk`.
        paper: lies on the floor where the scene is built anew; what lies there already stays. explained: as for `show`.
        """
        goal = goal and explained is None
        with self._lock:
            anew = not self._stands(trajectory, require_view(view), goal, explained)
            if anew:
                shown = trajectories or (trajectory,)
                close = paper is None and explained is None
                robots = (bodies.NEUTRAL,)
                self._show(
                    trajectory.scene, require_view(view), shown, robots, goal=goal, close=close, explained=explained
                )
            self._run(
                {
                    "type": "play",
                    "playback_id": playback_id,
                    "label": label,
                    "label_s": label_s if label else GET_SET_S if walking else 0.0,
                    "hold_s": explained.hold_s if explained else HOLD_S,
                    "tracks": [pose_track(trajectory.times, trajectory.poses)],
                    "person": walk_track(trajectory.scene),
                    "walk": surroundings(trajectory.scene, "you") if walking else None,
                    "paper": paper.as_message(trajectory.scene, view) if paper and anew else None,
                }
            )

    def replay(
        self,
        rollouts: Sequence[Trajectory],
        *,
        names: Sequence[str],
        speed: float = 1.0,
        loop: bool = True,
        view: View = "top_down",
        beside: Sequence[Beside] = (),
        pictures: Sequence[CameraPictures] = (),
        explained: ShownExplanation | None = None,
    ) -> None:
        """For analysts: one or two trajectories of one scene at once, coloured, with their paths; the camera is free.

        beside: further paths that lie on the floor. pictures: what the robots' cameras see meanwhile. explained: what
        is shown of the first one's reasons.
        Raises ValueError when the scenes differ, there are more or fewer, or the speed is not positive.
        """
        colours = (bodies.LEFT, bodies.RIGHT)[: len(rollouts)]
        if not 1 <= len(rollouts) <= 2:
            raise ValueError(f"replay field 'rollouts' has {len(rollouts)} of them: one or two can be shown")
        if rollouts[0].scene != rollouts[-1].scene:
            raise ValueError(
                f"replay field 'rollouts[1].scene' = {rollouts[1].scene.digest()[:8]}: two rollouts need one scene, "
                f"the first has {rollouts[0].scene.digest()[:8]}"
            )
        if not speed > 0:
            raise ValueError(f"replay field 'speed' = {speed!r}: needs a number above 0, 1 is real time")
        with self._lock:
            if self._gone:
                return
            self._show(rollouts[0].scene, require_view(view), rollouts, colours, explained=explained)
            for number, (trajectory, colour) in enumerate(zip(rollouts, colours, strict=True)):
                scene_nodes.add_paths(
                    self._client.scene, f"{self._root}/path{number}", [trajectory.poses], colour.top, DRIVEN_PATH_M
                )
            for number, laid in enumerate(beside):
                scene_nodes.add_paths(self._client.scene, f"{self._root}/beside{number}", laid.paths, laid.colour)
            self._run(
                {
                    "type": "replay",
                    "tracks": [pose_track(rollout.times, rollout.poses) for rollout in rollouts],
                    "person": walk_track(rollouts[0].scene),
                    "speed": speed,
                    "loop": loop,
                    "legend": [
                        {"name": name, "colour": list(colour)}
                        for name, colour in (
                            *zip(names, (robot.top for robot in colours), strict=True),
                            *((laid.name, laid.colour) for laid in beside),
                        )
                    ],
                    "pictures": [picture.as_sheet(colours[picture.robot].top) for picture in pictures],
                }
            )

    def clear(self) -> None:
        """An empty stage."""
        with self._lock:
            if self._gone:
                return
            self._client.scene.reset()
            self._showing = None
            self._run({"type": "clear"})

    def leave(self) -> None:
        """The page is gone: orders that come late do nothing. `StageServer` says so."""
        self._gone = True

    def retire(self) -> None:
        """Tell the page that another connection took its place, and drop it. It will not come back by itself."""
        with self._lock:
            self._run({"type": "replaced"})
            self._client.flush()
        self._close()

    @property
    def _root(self) -> str:
        return f"/scene{self._shown}"

    def _stands(self, trajectory: Trajectory, view: View, goal: bool, explained: ShownExplanation | None) -> bool:
        """Whether the scene that is shown will do for this trajectory, so that B is not framed anew after A."""
        now = self._showing
        wanted = (trajectory.scene, view, (bodies.NEUTRAL,), goal, explained)
        if now is None or (now.scene, now.view, now.robots, now.goal, now.explained) != wanted:
            return False
        return holds(now.frame, trajectory)

    def _show(
        self,
        scene: Scene,
        view: View,
        trajectories: Sequence[Trajectory],
        robots: tuple[bodies.RobotColours, ...],
        *,
        goal: bool = False,
        close: bool = False,
        explained: ShownExplanation | None = None,
        end: Floats | None = None,
        around_m: float = 0.0,
    ) -> None:
        camera = camera_for(scene, view, trajectories, close=close, goal=goal, around_m=around_m)
        stands = scene.person.pose if scene.has_person else scene.start  # nobody was recorded: no body is put there
        showing = _Showing(scene, view, camera.frame, robots, goal, explained)
        with self._lock:
            if self._gone or showing == self._showing:
                return
            self._shown += 1
            with self._client.atomic():
                self._client.scene.reset()
                self._nodes = scene_nodes.build(
                    self._client.scene, self._root, scene, view, camera, robots, self.detail
                )
                if goal:
                    marks = scene_nodes.add_marks(self._client.scene, self._root, scene, self._nodes.robots)
                    self._nodes = replace(self._nodes, meshes=(*self._nodes.meshes, *marks))
                reasons, robot = None, get_setup(scene.setup).robot
                if explained:
                    reasons, added = explained_nodes.add_explained(self._client.scene, self._root, scene, explained)
                    self._nodes = replace(self._nodes, meshes=(*self._nodes.meshes, *added))
                self._run(
                    {
                        "type": "show",
                        "explained": reasons,
                        "halted": None if end is None else [float(value) for value in end],
                        "camera": camera.as_message(),
                        "meshes": list(self._nodes.meshes),
                        "robots": list(self._nodes.robots),
                        "robot_size": [robot.radius_m, robot.height_m],
                        "person": self._nodes.person,
                        "crowd": [
                            {"name": name, "track": track}
                            for name, track in zip(self._nodes.crowd, crowd_tracks(scene), strict=True)
                        ],
                        "goal": [scene.goal.x, scene.goal.y, scene.goal_radius] if goal else None,
                        "stands": [stands.x, stands.y, stands.yaw],
                        "start": [scene.start.x, scene.start.y, scene.start.yaw],
                        "sharpness": SHARPNESS[self.detail],
                    }
                )
            self._showing = showing

    def _run(self, order: Order) -> None:
        if not self._gone:
            viser_hooks.run_javascript(self._client, f"window.desirePath.run({json.dumps(order)})")
