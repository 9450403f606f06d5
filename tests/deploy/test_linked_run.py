"""A run that a server asks for: what its orders make a node do. The server's own side is in `tests/web`; here it is a
list of what was said, so that every order comes at its moment."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from desirepath.deploy.inputs import Command, Person
from desirepath.deploy.link import Orders
from desirepath.deploy.ros.linked import LinkedRun
from desirepath.deploy.safety import Refused, State
from tests.deploy.test_safety import Rig

READY = Orders(number=1, run="r1", goal=(2.0, 0.0), person=(1.0, 2.0))


class Server:
    def __init__(self) -> None:
        self.orders, self.silent_s, self.refused = READY, 0.1, None
        self.said: list[dict[str, Any]] = []
        self.handed_in: dict[str, Any] = {}

    def say(self, said):
        self.said.append(said)

    def over(self, run, **what):
        self.handed_in = {"run": run, **what}


class Node:
    """Of the node what a run asks for."""

    def __init__(self, rig):
        self.rig, self.supervisor, self.controller = rig, rig.supervisor, rig.controller
        self.stops, self.weights, self.odom_in_map = [], [], (1.0, 0.0, math.pi / 2)
        self.controller.weights = {}
        rig.supervisor._told = lambda change: change.state is State.STOPPED and self.stops.append((0.0, change.reason))

    def act(self, name, by="by hand"):
        try:
            getattr(self.supervisor, name)(by)
        except Refused as why:
            return str(why)
        return self.supervisor.state.value

    def set_goal(self, goal):
        self.goal = goal
        self.supervisor.goal(goal)

    def set_people(self, people, lasting=False):
        self.supervisor.people(people, lasting)

    def set_weights(self, weights):
        self.weights.append(dict(weights))
        self.controller.weights = weights


@pytest.fixture
def at(monkeypatch):
    rig = Rig()
    rig.odometry.update(x=5.0, y=1.0)
    server = Server()
    monkeypatch.setattr("desirepath.deploy.ros.linked.time", SimpleNamespace(monotonic=lambda: rig.t))
    node = Node(rig)
    # the rig's controller wants what it is told and has no policy that could be driven on
    monkeypatch.setattr("desirepath.deploy.ros.linked.predict_way", lambda *heard: [(6.0, 1.0)])
    return SimpleNamespace(rig=rig, server=server, node=node, run=LinkedRun(server, READY, True, None))


def go_on(at, seconds):
    over = False
    for _ in range(round(seconds / 0.1)):
        at.rig.pass_time(0.1)
        over = over or at.run(at.node)
    return over


def test_the_server_starts_what_was_armed_and_hears_of_it(at):
    go_on(at, 2)
    assert at.node.supervisor.state is State.ARMED, "armed with the run, and waiting"
    assert (at.server.said[-1]["state"], at.server.said[-1]["reason"]) == ("armed", "armed for the server")
    at.server.orders = replace(READY, drive=True, weights={"farther": 1.0})
    go_on(at, 1.5)
    assert at.node.supervisor.state is State.DRIVING
    assert at.node.goal == (7.0, 1.0), "in the odometry's frame"
    assert at.node.supervisor.told_of == (Person(6.0, 3.0),)
    assert at.node.weights == [{"farther": 1.0}]
    assert at.server.said[-1]["pose"] == [0.0, 0.0, 0.0]
    assert at.server.said[-1]["plan"] == [[1.0, 0.0]], "in the run's frame"
    assert at.server.said[-1]["in_map"] == [0.0, 5.0, 1.571], "the run's frame in the map's"
    at.rig.controller.wanted, at.rig.controller.arrived = Command(0.0, 0.0), True
    assert go_on(at, 1)
    at.run.over(at.node)
    assert at.server.handed_in["run"] == "r1"
    assert (at.server.handed_in["reached"], at.server.handed_in["stops"]) == (True, [])


def test_it_says_since_when_it_is_driven_by_which_weights(at):
    at.server.orders = replace(READY, drive=True, weights={"farther": 1.0})
    go_on(at, 2)
    at.server.orders = replace(READY, number=2, drive=True, weights={"smoother": 0.5, "closer": 0.0})
    steps = at.node.supervisor.steps
    at.run(at.node)
    assert at.server.said[-1]["weights"] == {"farther": 1.0}
    go_on(at, 1)
    assert at.node.supervisor.steps > steps
    assert at.server.said[-1]["weights"] == {"smoother": 0.5}
    assert 0 <= at.server.said[-1]["since_s"] < 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda server: setattr(server, "orders", replace(READY, drive=False)), "the server says stop"),
        (lambda server: setattr(server, "orders", Orders(number=3)), "the server ended the run"),
        (lambda server: setattr(server, "silent_s", 1.2), "the connection to the server was cut: it is silent"),
        (
            lambda server: setattr(server, "refused", SimpleNamespace(status=0)),
            "the connection to the server was cut: namespace(status=0)",
        ),
    ],
)
def test_the_server_stops_it_also_by_being_gone(at, change, reason):
    at.server.orders = replace(READY, drive=True)
    go_on(at, 2)
    assert at.node.supervisor.state is State.DRIVING
    change(at.server)
    go_on(at, 0.1)
    assert (at.node.supervisor.state, at.node.supervisor.reason) == (State.STOPPED, reason)
    at.run.over(at.node)
    assert not at.server.handed_in["reached"]
    assert [why for _, why in at.server.handed_in["stops"]] == [reason]


def test_without_arm_whoever_stands_beside_it_arms_it(at):
    at.run = LinkedRun(at.server, READY, False, None)
    at.server.orders = replace(READY, drive=True)
    go_on(at, 2)
    assert at.node.supervisor.state is State.OFF
    at.node.act("arm")
    go_on(at, 1)
    assert at.node.supervisor.state is State.DRIVING


def test_a_stopped_run_goes_on_where_somebody_arms_it_again(at):
    at.server.orders = replace(READY, drive=True)
    go_on(at, 2)
    at.node.supervisor.stop("somebody is 0.3 m away")
    assert not go_on(at, 1)
    assert at.node.supervisor.state is State.STOPPED, "nothing starts it by itself"
    at.node.act("arm")
    go_on(at, 1)
    assert at.node.supervisor.state is State.DRIVING
