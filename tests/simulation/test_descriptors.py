"""Group descriptors of two scans: against an independent implementation, in a world that stands still, on who walks."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from desirepath.simulation.crowds.crowd_engine import GROUPS, CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.crowds.descriptor_kernels import align_scan, describe_groups
from desirepath.simulation.pedestrians import Crowd, CrowdConditions
from desirepath.simulation.scene import Person, Pose, Room, Scene

RANGE_M = 3.5


def groups_by_the_book(older, newer, older_ranges, newer_ranges):
    """Algorithm 4.1 line by line, with sets, angles and a k-d tree."""
    seen_older, seen_newer = older[older_ranges < RANGE_M - 1e-3], newer[newer_ranges < RANGE_M - 1e-3]
    trees = cKDTree(seen_older), cKDTree(seen_newer)
    angles = np.arctan2(newer[:, 1], newer[:, 0])
    found = []
    for i in range(GROUPS):
        reference = 2 * math.pi * i / GROUPS
        near = np.abs(np.angle(np.exp(1j * (angles - reference)))) <= math.pi / GROUPS + 1e-7
        r = min([RANGE_M, *newer_ranges[near]])
        centre = r * np.array([math.cos(reference), math.sin(reference)])
        members = [
            seen[tree.query_ball_point(centre, 0.25)]
            for seen, tree in zip((seen_older, seen_newer), trees, strict=False)
        ]
        centroids = [some.mean(axis=0) if len(some) else None for some in members]
        known = [one for one in centroids if one is not None] or [centre]
        found.append(np.concatenate([one if one is not None else known[0] for one in centroids]))
    return np.array(found)


def two_scans(seed, noise=0.025):
    scene = draw_crowd_scene(TRAINED_SETUPS[seed % 3], seed, CrowdConditions(moving=(4, 4)))
    engine = CrowdEngine(n_envs=1, noise_m=noise)
    engine.reset([scene])
    for _ in range(3):
        engine.step(np.array([[0.2, 0.1]], np.float32))
    return engine


@pytest.mark.parametrize("seed", range(6))
def test_groups_are_those_of_an_independent_implementation(seed):
    e = two_scans(seed)
    ours = np.zeros((GROUPS, 4))
    describe_groups(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0], RANGE_M, False, ours)
    theirs = groups_by_the_book(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0])
    assert np.abs(ours - theirs).max() < 1e-9


def aligned_by_the_book(older, newer, older_ranges, newer_ranges):
    """ICP as `align_scan` has it, with all points within 20 sectors looked at for each: (turn, x, y)."""
    sees, sees_newer = older_ranges < RANGE_M * (1 - 1e-6), newer_ranges < RANGE_M * (1 - 1e-6)

    def unlike(shift):
        there, known = np.roll(newer_ranges, -shift), np.roll(sees_newer, -shift)
        apart = np.where(sees & known, np.minimum(np.abs(older_ranges - there), 0.5), 0.25)
        return apart[sees | known].mean()

    shifts = range(-18, 19)
    turn = 2 * math.pi / 180 * min(shifts, key=unlike)
    out, shift, allowed = older @ turned(turn).T, np.zeros(2), 0.5
    neighbours = [np.roll(newer, -side, axis=0) for side in (-1, 1)]
    known = [np.roll(sees_newer, -side) for side in (-1, 1)]
    for _ in range(30):
        apart = np.linalg.norm(out[:, None] - newer, axis=2)
        apart[:, ~sees_newer] = np.inf
        off = np.floor(np.arctan2(out[:, 1], out[:, 0]) / (2 * math.pi) * 180)[:, None] - np.arange(180)
        apart[np.abs((off + 90) % 180 - 90) > 20] = np.inf
        which = apart.argmin(axis=1)
        paired = sees & (apart.min(axis=1) < allowed)
        nearest, best = newer[which].copy(), apart.min(axis=1)
        for other, seen in zip(neighbours, known, strict=True):
            along = other[which] - newer[which]
            length = (along**2).sum(axis=1)
            t = np.clip(((out - newer[which]) * along).sum(axis=1) / np.maximum(length, 1e-12), 0, 1)
            foot = newer[which] + t[:, None] * along
            nearer = seen[which] & (length < 0.25) & (np.linalg.norm(foot - out, axis=1) < best)
            nearest[nearer], best[nearer] = foot[nearer], np.linalg.norm(foot - out, axis=1)[nearer]
        p, q = out[paired], nearest[paired]
        pm, qm = p - p.mean(axis=0), q - q.mean(axis=0)
        angle = math.atan2((pm[:, 0] * qm[:, 1] - pm[:, 1] * qm[:, 0]).sum(), (pm * qm).sum())
        move = q.mean(axis=0) - turned(angle) @ p.mean(axis=0)
        out, shift, turn = out @ turned(angle).T + move, turned(angle) @ shift + move, turn + angle
        if allowed <= 0.12 and np.linalg.norm(move) < 1e-4 and abs(angle) < 1e-4:
            break
        allowed = max(allowed / 2 if allowed > 0.24 else 0.12, 0.12)
    return turn, *shift


def turned(angle):
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


@pytest.mark.parametrize("seed", range(12))
def test_alignment_by_fewer_points_is_icp_with_all_of_the_window(seed):
    e = two_scans(seed)
    found = align_scan(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0], RANGE_M, np.zeros((180, 2)))
    by_the_book = aligned_by_the_book(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0])
    assert np.allclose(found, by_the_book, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_alignment_finds_the_motion_that_a_general_optimiser_finds(seed):
    e = two_scans(seed)
    older, newer = (points[ranges < RANGE_M - 1e-3] for points, ranges in (
        (e.older_points[0], e.older_ranges[0]), (e.points[0], e.ranges[0])))  # fmt: skip
    tree = cKDTree(newer)

    def moved(q):
        c, s = math.cos(q[0]), math.sin(q[0])
        return older @ np.array([[c, s], [-s, c]]) + q[1:]

    def apart(q):
        return np.minimum(tree.query(moved(q))[0], 0.2)

    out = np.zeros((180, 2))
    ours = np.array(align_scan(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0], RANGE_M, out))
    theirs = least_squares(apart, ours + np.array([0.05, 0.05, -0.05]), diff_step=1e-4).x
    assert np.mean(apart(ours)) <= np.mean(apart(theirs)) + 0.004
    assert np.allclose(out[e.older_ranges[0] < RANGE_M - 1e-3], moved(ours), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_centroids_of_outlines_are_those_of_a_geometry_library(seed):
    e = two_scans(seed)
    ours = np.zeros((GROUPS, 4))
    describe_groups(e.older_points[0], e.points[0], e.older_ranges[0], e.ranges[0], RANGE_M, True, ours)
    points, seen = e.points[0], e.ranges[0] < RANGE_M - 1e-3
    by_points = groups_by_the_book(e.older_points[0], points, e.older_ranges[0], e.ranges[0])
    joined = [
        shapely.LineString([points[k], points[(k + 1) % 180]])
        for k in range(180)
        if seen[k] and seen[(k + 1) % 180] and math.dist(points[k], points[(k + 1) % 180]) <= 0.25
    ]
    outline, angles = shapely.MultiLineString(joined), np.arctan2(points[:, 1], points[:, 0])
    for i in range(GROUPS):
        reference = 2 * math.pi * i / GROUPS
        near = np.abs(np.angle(np.exp(1j * (angles - reference)))) <= math.pi / GROUPS + 1e-7
        r = e.ranges[0][near].min(initial=RANGE_M)
        centre = r * np.array([np.cos(reference), np.sin(reference)])
        within = outline.intersection(shapely.Point(centre).buffer(0.25, 512))
        if within.length > 0:
            assert np.abs(np.array(within.centroid.coords[0]) - ours[i, 2:]).max() < 1e-4
        elif (np.linalg.norm(points[seen] - centre, axis=1) <= 0.25).any():
            assert np.allclose(ours[i, 2:], by_points[i, 2:])


def still_room(seed):
    """Nobody between the four walls of a room, of which the robot sees the most."""
    rng = np.random.default_rng(seed)
    room = Room(rng.uniform(3.0, 4.0), rng.uniform(2.6, 3.4))
    far = Person(Pose(50.0, 50.0))
    scene = Scene("crowd_office", seed, Pose(0, 0, rng.uniform(-3, 3)), Pose(1.0, 0.0), 0.2, far, (), room)
    return replace(scene, crowd=Crowd("path", ()))


def gaps(scenes, icp, outline, noise=0.0):
    """(n, 30) m of robots that have moved for one step."""
    engine = CrowdEngine(n_envs=len(scenes), icp=icp, outline=outline, noise_m=noise)
    engine.reset(scenes)
    rng = np.random.default_rng(0)
    engine.step((rng.uniform(-1, 1, (len(scenes), 2)) * [1.0, 0.5]).astype(np.float32))
    found = engine.descriptors()
    return np.hypot(found[..., 0] - found[..., 2], found[..., 1] - found[..., 3])[engine.outcomes == 0]


def test_what_stands_still_shows_no_gap_once_aligned_and_shows_one_without():
    rooms = [still_room(seed) for seed in range(40)]
    aligned, raw, by_points = gaps(rooms, True, True), gaps(rooms, False, True), gaps(rooms, True, False)
    assert (aligned < 0.02).mean() > 0.99
    assert aligned.max() < 0.04, "at corners, which fall between two beams"
    assert (raw > 0.02).mean() > 0.7
    assert by_points.max() > 0.02, "points of two scans of one wall are not the same points"


def test_in_furnished_buildings_only_what_was_hidden_shows_a_gap():
    scenes = [draw_crowd_scene(TRAINED_SETUPS[seed % 3], seed) for seed in range(60)]
    scenes = [replace(scene, crowd=Crowd("path", ())) for scene in scenes]
    aligned, raw = gaps(scenes, True, True), gaps(scenes, False, True)
    noisy, by_points = gaps(scenes, True, True, 0.025), gaps(scenes, True, False, 0.025)
    for name, some in (("aligned", aligned), ("raw", raw), ("noise", noisy), ("noise, points", by_points)):
        print(f"{name}: {(some < 0.02).mean():.3f} below 2 cm, quantiles {np.quantile(some, [0.5, 0.9, 1])}")
    assert (aligned < 0.02).mean() > 0.9
    assert (raw < 0.02).mean() < 0.5


def gaps_of_walkers(scenes=60):
    """(true motion, gap) in m of the group nearest to each pedestrian that is seen within 2.5 m."""
    conditions = CrowdConditions(moving=(4, 4), standing=(1, 1), speeds=(0.3, 1.0))
    drawn = [draw_crowd_scene(TRAINED_SETUPS[seed % 3], seed, conditions) for seed in range(scenes)]
    engine = CrowdEngine(n_envs=scenes)
    engine.reset(drawn)
    rng = np.random.default_rng(2)
    found = []
    for _ in range(12):
        before = engine.people_xy.copy()
        engine.step((rng.uniform(-1, 1, (scenes, 2)) * [1.0, 0.2]).astype(np.float32))
        described = engine.descriptors()
        for i in np.flatnonzero(~engine.dones):
            x, y, yaw = engine.poses[i]
            turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
            for p in range(1, 5):
                here = turn @ (engine.people_xy[i, p] - [x, y])
                motion = turn @ (engine.people_xy[i, p] - before[i, p])
                away = np.linalg.norm(described[i, :, 2:] - here, axis=1)
                g = int(away.argmin())
                if away[g] < 0.3 and np.linalg.norm(here) < 2.5:
                    found.append((motion, described[i, g, 2:] - described[i, g, :2]))
    return np.array(found)


def test_gaps_of_pedestrians_follow_how_they_moved():
    pairs = gaps_of_walkers()
    motion, gap = pairs[:, 0].ravel(), pairs[:, 1].ravel()
    correlation = np.corrcoef(motion, gap)[0, 1]
    print(f"{len(pairs)} pairs, correlation of components {correlation:.3f}")
    assert correlation > 0.6
