"""Kind of step `robot_drive`: a real robot drives as somebody's answers taught it, started by the experimenter's hand.

They move its weights while it drives, and say afterwards how they liked it. The robot's side is `study/robots.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import Field
from sqlalchemy import func, select

from desirepath.grammar.parts import an_example
from desirepath.simulation.scene import Pose, Scene, UnrecordedPerson
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.models import Response, RobotRun, StudyRobot
from desirepath.study import robots
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.live import LiveAnswer, LiveStep, Weights, check_history
from desirepath.study.kinds.questionnaire import within
from desirepath.study.kinds.tuning import Tuning, TuningStage, TuningStep
from desirepath.study.steps import Planning
from desirepath.study.wire import Progress, WholeNumber

POINTS = 7
MOST_WALLS = 1_000  # ours: rectangles of a map that a page is sent
AROUND_M = 1.5  # ours: of the floor around start and goal, where the robot may go and its lidar sees
Metres = Annotated[float, Field(ge=-robots.REACH_M, le=robots.REACH_M, allow_inf_nan=False)]
Goal = tuple[Metres, Metres]


class RobotDriveStage(TuningStage):
    """A robot that stands in the room drives, started by the experimenter on the lab's page *Robots*; its weights can
    be moved meanwhile. goal: [x, y] m from where it stands, x ahead. start: `learned` from the answers before it, or
    none (`neutral`). Who is asked by a program is shown a drive of the simulation.
    """

    model_config = an_example({"setup": "study_room", "start": "learned", "goal": [3.0, 0.0]})

    goal: Goal = (3.0, 0.0)

    def plan(self, at: Planning) -> list[RobotDriveStep]:  # type: ignore[override]  # a list of steps
        step = super().plan(at)[0].model_dump(exclude_unset=True)
        return [RobotDriveStep.model_validate(step | {"kind": "robot_drive", "scenes": 1, "goal": self.goal})]


class RobotDriveStep(TuningStep):
    """goal: m from where the robot stands when it starts."""

    kind: Literal["robot_drive"]  # type: ignore[assignment]  # of another kind than the one it extends
    goal: Goal


class RobotDriveAnswer(LiveAnswer):
    """liked: how it drove; 1 not at all, 7 very much; None: it did not drive."""

    liked: WholeNumber | None = Field(None, description=f"1 to {POINTS}")


class RobotRunState(Progress):
    """How far a robot's drive is. robot: its name, None: the experimenter has not chosen one yet."""

    phase: Literal["waiting", "driving", "over"]
    robot: str | None
    drove: bool
    wheels_after_s: float | None = Field(description="from the last answer to wheels turning")
    answers: int = Field(description="how many answers it learned from")


class RobotDrive(Tuning):
    name = "robot_drive"
    step = RobotDriveStep  # type: ignore[assignment]
    answers = RobotDriveAnswer
    progress = RobotRunState
    stages = {"robot_drive": RobotDriveStage}
    around_m = AROUND_M
    stored = Tuning.stored | {
        "liked": "how the robot drove: 1 not at all, 7 very much; null: it did not drive",
        "run": "the drive; null: there was none",
        "recording": "sha256 of its MCAP, in the folder recordings; null: it was not handed in before the answer",
        "simulated": "whether no robot but the simulation drove",
        "driven_s": "seconds that it drove",
        "way_m": "metres that it drove",
        "reached": "whether it came to its goal",
        "stops": "why it stopped, with seconds since the drive began",
        "learned_from": "how many answers it had learned from",
        "wheels_after_s": "seconds from the last answer before the drive to wheels turning",
    }

    def payload(self, step: TuningStep, page: Page) -> dict[str, Any]:
        return super().payload(step, page) | {"points": POINTS, "walls": known_walls(step.setup)}

    def state(self, step: TuningStep, moment: Moment) -> dict[str, Any] | None:
        run = robots.run_at(moment.s, moment.session, step.key)
        if run is None:
            return None
        robot = moment.s.get(StudyRobot, run.robot_id) if run.robot_id else None
        phase = {"waiting": "waiting", "started": "driving"}.get(run.state, "over")
        told = {"phase": phase, "robot": robot.name if robot else None, "drove": run.summary is not None}
        return told | {"wheels_after_s": robots.wheels_after_s(run), "answers": run.answers}

    def scene(self, step: LiveStep, place: int) -> tuple[Scene, tuple[Trajectory, ...]]:
        """An empty floor: what really stands there, the robot's lidar shows."""
        assert isinstance(step, RobotDriveStep)  # noqa: S101  its own steps
        return empty_floor(step.setup, step.goal), ()

    def arrive(self, step: TuningStep, acting: Acting) -> None:
        assert isinstance(step, RobotDriveStep)  # noqa: S101  its own steps
        super().arrive(step, acting)
        session = acting.session
        taught = select(func.count(), func.max(Response.created_at))
        count, last = acting.s.execute(
            taught.where(Response.session_id == session.id, Response.trial_id.is_not(None))
        ).one()
        run = RobotRun(
            study_id=session.study_id, session_id=session.id, step_key=step.key, simulated=session.simulated,
            setup=step.setup, goal=list(step.goal), weights=self.start(step, acting), answers=count, asked_at=last,
        )  # fmt: skip
        acting.s.add(run)
        acting.s.flush()
        if session.simulated:
            robots.end_run(acting.s, run, acting.now, _simulated_drive(step, run.weights))
        else:
            robots.offer(acting.s, run)

    def start(self, step: TuningStep, moment: Moment) -> Weights:
        """The weights that it begins with."""
        return dict(self.payload_now(step, moment)["start"])

    def keep(self, step: TuningStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        run = robots.run_at(acting.s, acting.session, step.key)
        if run is not None and run.state != "over":
            raise acting.refusal("still_driving", "The robot's drive is not over yet.")
        drove = run.summary if run is not None else None
        if drove is not None and stored["liked"] is None:
            raise acting.refusal(
                "bad_value", f"must be a whole number from 1 to {POINTS}", status=422, field="value.liked"
            )
        start = self.start(step, acting)
        check_history(start, stored)
        facts: dict[str, Any] = {"start": start, "run": run.id if run else None}
        facts |= {"recording": run.recording if run else None, "simulated": bool(run and run.simulated)}
        facts |= {name: (drove or {}).get(name) for name in ("driven_s", "way_m", "reached", "stops")}
        facts |= {"learned_from": run.answers if run else 0}
        return facts | {"wheels_after_s": robots.wheels_after_s(run) if run else None}

    def check(self, step: TuningStep, answer: LiveAnswer, page: Page) -> dict[str, Any]:
        assert isinstance(answer, RobotDriveAnswer)  # noqa: S101  its own answers
        liked = None if answer.liked is None else within("value.liked", answer.liked, 1, POINTS)
        return super().check(step, answer, page) | {"liked": liked}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        answered = super().simulate(step, participant)
        apart = sum(abs(change["weight"]) for change in answered["history"])
        return answered | {"liked": max(1, POINTS - round(apart))}


def empty_floor(setup: str, goal: tuple[float, float]) -> Scene:
    """A floor on which nothing stands, with the setup's robot at the origin."""
    from desirepath.simulation.setups import get_setup

    of = get_setup(setup)
    return Scene(setup, 0, Pose(0.0, 0.0), Pose(*goal), of.goal_radius_m, UnrecordedPerson())


@lru_cache(maxsize=8)
def known_walls(setup: str) -> list[list[tuple[float, float]]]:
    """What stands in every scene of a setup, as corners (m, its map's frame): the walls of its room, or all that its
    lab drew of a building, the largest of a map; nothing of a place that is furnished anew each time."""
    from desirepath.simulation.scenes import own_map
    from desirepath.simulation.setups import get_setup
    from desirepath.study.personalising.live_rollouts import scenes_of

    scene = scenes_of(setup)[0]
    solids = [*(scene.room.walls() if scene.room else ()), *(scene.obstacles if get_setup(setup).plan else ())]
    walls = [one.corners() for one in solids]
    here = own_map(scene)
    if here is not None:
        largest = sorted(here.walls.tolist(), key=lambda r: (r[0] - r[2]) * (r[3] - r[1]))[:MOST_WALLS]
        walls += [[(a, b), (c, b), (c, d), (a, d)] for a, b, c, d in largest]
    return [[(round(x, 2), round(y, 2)) for x, y in corners] for corners in walls]


def _simulated_drive(step: RobotDriveStep, weights: Mapping[str, float]) -> dict[str, Any]:
    """The drive that a program is shown, in the first of the setup's places."""
    import numpy as np

    from desirepath.study.personalising import live_rollouts as live

    drive = live.roll_out(live.condition_on(step.setup, weights), live.scenes_of(step.setup)[0])
    way = float(np.linalg.norm(np.diff(drive.poses[:, :2], axis=0), axis=1).sum())
    return {
        "driven_s": round(drive.duration_s, 2),
        "way_m": round(way, 2),
        "reached": live.path_of(drive).arrives,
        "stops": [],
    }


KIND = RobotDrive()
