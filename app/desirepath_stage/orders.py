"""What the stage's page is ordered to do, and what it tells of the pen: the shapes of the messages, no behaviour.

Metres, seconds, radians, world frame. The page's own types are made from these (`contract.d.ts`), so that both sides
are checked against one contract. The events that it posts to the window that holds it are listed in `page.py`.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict  # Pydantic wants this one before Python 3.12

ViewName = Literal["top_down", "first_person", "immersive"]

Track = list[list[float]]
"""Rows of [t s, x m, y m, yaw rad], yaw without jumps."""


class CameraOrder(TypedDict):
    """How a scene is seen: frame (x_min, y_min, x_max, y_max) must be in sight from above."""

    view: ViewName
    eye: list[float]
    target: list[float]
    fov_rad: float
    frame: list[float]


class Solid(TypedDict):
    """A box on the floor; `name`: what the page's words call it."""

    name: str
    x: float
    y: float
    yaw: float
    length: float
    width: float


class Round(TypedDict):
    """Somebody who stands on the floor."""

    name: str
    x: float
    y: float
    radius: float


class ExplainedObject(Solid):
    """A thing that was scored. outline: its mesh, "" where none is shown; height: metres."""

    thing: str
    outline: str
    height: float


class Attention(TypedDict):
    """What a policy looks at: weights per 0.2 s of lidar sectors and of descriptor rays, from straight ahead on,
    counter-clockwise. mesh: of a quadrilateral each; radius: the robot's, m.
    """

    mesh: str
    spatial: list[list[float]]
    temporal: list[list[float]]
    radius: float


class Explained(TypedDict):
    """What is shown of a policy's reasons. scores: one row per 0.2 s, as `objects`; rays: the mesh of the lidar's,
    "" where none are shown, of those bearings from its `mount` (x, y, yaw) on the robot, ending also at who walks, each
    `walker` (length, width) large; line, goal (x, y, radius): where the robot goes.
    """

    attention: Attention | None

    objects: list[ExplainedObject]
    scores: list[list[float]]
    thickest_m: float
    rays: str
    bearings: list[float]
    mount: list[float]
    range_m: float
    solids: list[Solid]
    person: Round
    walker: list[float]
    robot_radius: float
    robot_height: float
    line: str
    goal: list[float]


class Walker(TypedDict):
    """One pedestrian: the name of their node, and where they are from the moment on in which the robot moves."""

    name: str
    track: Track


class ShowOrder(TypedDict):
    """A scene has been built; say so once all of it can be seen. halted: where the robot stands already, after its
    rollout was watched. robot_size: radius and height of each. crowd: who walks beside the person. goal (x, y, radius):
    where it is shown, with a trail.
    """

    type: Literal["show"]
    explained: Explained | None
    halted: list[float] | None
    camera: CameraOrder
    meshes: list[str]
    robots: list[str]
    robot_size: list[float]
    person: str
    crowd: list[Walker]
    goal: list[float] | None
    stands: list[float]
    start: list[float]
    sharpness: float


class Surroundings(TypedDict):
    """What stands around a robot or a walker."""

    solids: list[Solid]
    person: Round
    robot_radius: float


class Drawn(TypedDict):
    """A whole stroke: points [[x, y], ...], speeds m/s wanted there, times_s of the hand."""

    points: list[list[float]]
    speeds: list[float]
    times_s: list[float]


class StrokeTrouble(TypedDict):
    """What is wrong with the stroke on the paper: `at`, and which thing is touched, where that says something."""

    code: str
    at: list[float] | None
    thing: str | None


class PaperOrder(Surroundings):
    """A sheet of paper to draw a path on; see `paper.Paper`."""

    id: str
    start: list[float]
    goal: list[float]
    speeds: list[float]
    kept: list[list[list[float]]]
    drawn: Drawn | None
    resting: bool
    problem: StrokeTrouble | None
    walks: list[Track]
    chosen: int | None
    most_points: int
    tight_m: float


class DrawOrder(PaperOrder):
    """Let a path be drawn."""

    type: Literal["draw"]


class PlayOrder(TypedDict):
    """Show the label, then the motion, then hold its end; `walk`: what is around a participant who walks themselves."""

    type: Literal["play"]
    playback_id: str
    label: str
    label_s: float
    hold_s: float
    tracks: list[Track]
    person: Track | None
    walk: Surroundings | None
    paper: PaperOrder | None


class LegendEntry(TypedDict):
    """A name beside its colour, red, green and blue up to 255; hollow: drawn as a ring, as its way is as two lines."""

    name: str
    colour: list[int]
    hollow: NotRequired[bool]


class PictureSheet(TypedDict):
    """What a robot's camera saw: `count` pictures of width x height pixels, `across` in a row of the image, one every
    `every_s` of the rollout. name, colour: the robot's, as in the legend."""

    name: str
    colour: list[int]
    caption: str
    image: str
    width: int
    height: int
    across: int
    count: int
    every_s: float


class ReplayOrder(TypedDict):
    """Rollouts side by side, for analysts; pictures: what their cameras saw meanwhile."""

    type: Literal["replay"]
    tracks: list[Track]
    person: Track | None
    speed: float
    loop: bool
    legend: list[LegendEntry]
    pictures: list[PictureSheet]


class PlainOrder(TypedDict):
    """clear: an empty stage; replaced: another connection took this one's place."""

    type: Literal["clear", "replaced"]


class LivePath(TypedDict):
    """What a robot would drive: `arrives`: whether it comes to the goal; colour up to 255 each; hollow: two lines, so
    that ways are told apart not by colour alone."""

    track: Track
    colour: list[int]
    hollow: bool
    arrives: bool


class PathsMessage(TypedDict):
    """From the page: one path per robot of the scene; onward: from where it is, so that it drives on; since: for how
    many seconds each had been under way there."""

    do: Literal["paths"]
    id: str
    onward: bool
    since: list[float] | None
    paths: list[LivePath]
    legend: list[LegendEntry]


class NumberedPaths(TypedDict):
    """Several ways of one robot, told apart by number and colour, of which the page says which one it drives (`drive`
    with `only`, from 0). person: how the scene's person walks meanwhile, None where they stand."""

    type: Literal["steer"]
    do: Literal["paths"]
    id: str
    onward: bool
    numbered: bool
    paths: list[LivePath]
    person: Track | None


class MirrorOrder(TypedDict):
    """From the page: where a real robot is (x, y, yaw), what its lidar hit, where it would go, where people stand.
    walls: corners of what its map has; absent: as before."""

    pose: list[float]
    scan: list[list[float]]
    plan: list[list[float]]
    people: list[list[float]]
    walls: NotRequired[list[list[list[float]]]]


class RobotsMoved(TypedDict):
    """The event `moved`: where the robots are on their paths, and for how many seconds each has been under way."""

    poses: list[list[float]]
    clocks: list[float]
    seconds: float
    driving: bool
    over: bool


Order = ShowOrder | DrawOrder | PlayOrder | ReplayOrder | NumberedPaths | PlainOrder


class Near(TypedDict):
    """The nearest thing, how far the robot's edge is from it (negative: inside), and whether that room is tight."""

    name: str
    metres: float
    tight: bool


class PenState(TypedDict):
    """The event `drawing`: how the stroke stands. near: to the pen; tight: the worst place of the stroke."""

    drawing: bool
    can_undo: bool
    can_redo: bool
    can_finish: bool
    at_goal: bool
    length_m: float
    seconds: float
    speed: float
    speeds: list[float]
    near: Near | None
    tight: Near | None
    keys: bool
    problem: bool
    walk: int | None
    must_choose: bool


def shapes() -> list[Any]:
    """Everything here that the pages' types are made of."""
    return [value for value in globals().values() if isinstance(value, type) and value.__module__ == __name__]
