"""A run that a server asks for: its orders to a node, where the robot is to the server."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from desirepath.deploy.conditioning import WeightsError
from desirepath.deploy.inputs import Odometry, Person
from desirepath.deploy.link import Frame, Link, LinkError, Orders, Place, describe
from desirepath.deploy.predicting import predict_way
from desirepath.deploy.recorder import Recorder
from desirepath.deploy.safety import State

if TYPE_CHECKING:
    from desirepath.deploy.ros.node import DriveNode

CUT_S = 1.0  # a server that is told five times a second and answers nothing for so long is gone
SAY_EVERY_S = 0.2
AGAIN_S = 0.3


class LinkedRun:
    """Ask it as often as a node is spun, until it says that the run is over.

    The robot is armed by whoever stands beside it, or as the run begins where `arms` says so. The server starts it and
    stops it, changes weights, says where the person is. A connection that was cut stops it.
    """

    def __init__(self, link: Link, orders: Orders, arms: bool, recorder: Recorder | None) -> None:
        self._link, self.run, self._arms, self._recorder = link, orders.run, arms, recorder
        self._frame = Frame()
        self._set_out = False
        self._weights: Mapping[str, float] | None = None
        self._steps_before, self._weighed_at = -1, -math.inf  # of its weights; its first command by them
        self._person: Place | None = None
        self._tried = self._said = self._began = -math.inf

    def __call__(self, node: DriveNode) -> bool:
        """Whether the run is over."""
        one, orders, now = node.supervisor, self._link.orders, time.monotonic()
        if orders.run != self.run:
            one.stop("the server ended the run")
            return True
        if self._arms and not self._set_out and one.state is State.OFF and self._may_try(now):
            node.act("arm", "for the server")
        if one.where is not None:
            self._follow(node, orders, one.where, now)
            if self._weighed_at == -math.inf and one.steps > self._steps_before:
                self._weighed_at = now
            if now - self._said >= SAY_EVERY_S:
                self._said = now
                self._say(node, orders, one.where)
        return one.state is State.STOPPED and one.reason == "arrived"

    def _follow(self, node: DriveNode, orders: Orders, where: Odometry, now: float) -> None:
        one = node.supervisor
        if orders.drive and not self._set_out and orders.goal is not None:
            self._set_out, self._frame = True, Frame.at(where)
            node.set_goal(self._frame.out_of(orders.goal))
        if not self._set_out:
            self._frame = Frame.at(where)
        if orders.weights is not None and orders.weights != self._weights:
            self._weights = orders.weights
            self._steps_before, self._weighed_at = one.steps, -math.inf
            try:
                node.set_weights(orders.weights)
            except WeightsError as problem:
                node.get_logger().warning(str(problem))
        if orders.person is not None and (orders.person != self._person or not self._set_out):
            self._person = orders.person
            node.set_people([Person(*self._frame.out_of(orders.person))], lasting=True)
        if orders.drive and one.state is State.ARMED and self._may_try(now):
            started = node.act("start", "by the server").startswith(State.DRIVING.value)
            self._began = now if started and self._began == -math.inf else self._began
        if one.state is State.DRIVING:
            if not orders.drive:
                one.stop("the server says stop")
            elif self._link.silent_s > CUT_S or (self._link.refused is not None and not self._link.refused.status):
                one.stop(f"the connection to the server was cut: {self._link.refused or 'it is silent'}")

    def _may_try(self, now: float) -> bool:
        due = now - self._tried >= AGAIN_S
        self._tried = now if due else self._tried
        return due

    def _say(self, node: DriveNode, orders: Orders, where: Odometry) -> None:
        one = node.supervisor
        goal = self._frame.out_of(orders.goal) if orders.goal is not None else None
        plan: list[Place] = []
        if goal is not None and one.seen is not None and one.state in (State.ARMED, State.DRIVING):
            plan = predict_way(node.controller, one.seen, where, goal, one.told_of)
        weighed = self._weighed_at > -math.inf
        self._link.say(
            describe(
                self._frame,
                one.state.value,
                where,
                reason=one.reason,
                scan=one.seen,
                laser=node.controller.laser,
                goal=goal,
                people=one.told_of,
                plan=plan,
                in_map=Frame(*node.odom_in_map) if node.odom_in_map else None,
                driven_by=(node.controller.weights, time.monotonic() - self._weighed_at) if weighed else None,
            )
        )

    def over(self, node: DriveNode) -> None:
        """Hand the run in."""
        if not self._set_out or self.run is None or self._began == -math.inf:
            return
        stops = [(at_s - self._began, why) for at_s, why in node.stops if why != "arrived"]
        made = self._recorder
        try:
            self._link.over(
                self.run,
                driven_s=time.monotonic() - self._began,
                way_m=made.way_m if made is not None else 0.0,
                reached=node.supervisor.reason == "arrived",
                stops=[(max(0.0, at_s), why) for at_s, why in stops],
                recording=made.finish() if made is not None else None,
            )
        except LinkError as problem:
            node.get_logger().error(f"the run could not be handed in: {problem}")


def recorder_for(laser: Any) -> Recorder | None:
    """One, where the package mcap is there."""
    try:
        return Recorder(laser)
    except ModuleNotFoundError:
        return None
