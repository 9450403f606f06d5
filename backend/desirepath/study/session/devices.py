"""Whether a device can take part, and how much of the scene it should be shown. Measuring is the page's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeGuard

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.events import log_event
from desirepath.store.models import Session
from desirepath.study.protocol.schema import DeviceGate
from desirepath.study.refusals import Refused
from desirepath.study.session.versions import protocol_of


def device_problems(gate: DeviceGate | None, device: Mapping[str, Any]) -> list[str]:
    """What stands against that device: webgl, width, height, pointer, frame_rate, headset; [] where nothing does.

    device: `webgl`, `width`, `height` (CSS pixels of the window), `pointer` (fine, coarse), `frame_rate` (per second),
    `headset` (whether one can be worn).
    What the page could not tell stands against nobody, but WebGL, without which nothing can be shown.
    """
    if gate is None:
        return []
    problems = ["webgl"] if gate.webgl and not device.get("webgl") else []
    for name, least in (("width", gate.min_width), ("height", gate.min_height), ("frame_rate", gate.min_frame_rate)):
        measured = device.get(name)
        if least is not None and _is_number(measured) and measured < least:
            problems.append(name)
    if device.get("pointer") in ("fine", "coarse") and device["pointer"] not in gate.pointers:
        problems.append("pointer")
    if gate.headset == "required" and device.get("headset") is False:
        problems.append("headset")
    return problems


def fit_device(
    gate: DeviceGate | None, device: Mapping[str, Any], *, study_id: str, simulated: bool = False
) -> dict[str, Any]:
    """The device as the session keeps it, with `scene_detail`: full or light. Bots have no device and pass.

    Raises Refused 403 `device` with `reasons`.
    """
    problems = [] if simulated else device_problems(gate, device)
    if problems:
        message = f"This device cannot show the study: {', '.join(problems)}."
        raise Refused(403, "device", message, study_id=study_id, reasons=problems)
    rate = device.get("frame_rate")
    slow = gate is not None and gate.light_below is not None and _is_number(rate) and rate < gate.light_below
    return {**device, "scene_detail": "light" if slow else "full"} if gate is not None else dict(device)


def was_measured(s: DatabaseSession, session: Session) -> bool:
    """Whether a page has reported a device of this participant, in whichever appointment."""
    reports = s.scalars(select(Session.device).where(Session.participant_id == session.participant_id))
    return any("webgl" in device for device in reports)


def change_device(
    s: DatabaseSession, session: Session, gate: DeviceGate | None, device: Mapping[str, Any]
) -> dict[str, Any]:
    """Go on with that device; the one before stays in the log. Raises Refused 403 `device` with `reasons`."""
    fit = fit_device(gate, device, study_id=session.study_id, simulated=session.simulated)
    log_event(s, "device_checked", session_id=session.id, before=session.device, after=fit)
    session.device = fit
    return fit


def headset_required(s: DatabaseSession, session: Session) -> bool:
    """Whether what is seen from inside counts only with a headset. Bots wear none."""
    return not session.simulated and protocol_of(s, session).protocol.asked_of_devices.headset == "required"


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
