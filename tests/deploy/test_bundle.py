"""A bundle is whole, drives a robot that has nothing else of the house, and a hostile one is refused in words."""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from typer.testing import CliRunner

import desirepath.deploy
from desirepath.cli.main import app
from desirepath.deploy.bundle import Bundle
from desirepath.deploy.manifest import BundleError
from desirepath.learning.policies.bundles import bundle_files, zipped
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.npz import from_npz, to_npz
from tests.fences import fences_of

DRIVE = """
import json, sys
sys.path[:0] = [sys.argv[1], sys.argv[2]]
import numpy as np
from desirepath.deploy import controller
from desirepath.deploy.inputs import Command, Odometry, Person, Scan
assert controller.__file__.startswith(sys.argv[1]), controller.__file__
driver, apart = controller.Controller.load(sys.argv[1]), 0.0
for given in json.load(open(sys.argv[1] + "/test_vectors.json"))["vectors"]:
    scan, odometry = given["scan"], Odometry(**given["odometry"])
    driver.reset()
    driver.command = Command(odometry.v, odometry.w)
    people = [Person(**one) for one in given["people"]]
    told = driver.step(Scan(**dict(scan, ranges=np.array(scan["ranges"]))), odometry, given["goal"], people)
    apart = max(apart, abs(told.v - given["command"]["v"]), abs(told.w - given["command"]["w"]))
    apart = max(apart, np.abs(driver.observation - given["observation"]).max())
house = [one for one in sys.modules if one.partition(".")[0] in ("torch", "numba", "pydantic", "scipy", "onnxruntime")]
print(json.dumps({"apart": float(apart), "house": house}))
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    done = CliRunner().invoke(
        app, ["policies", "export", "study_room/conditioned", "--out", str(folder / "robot"), "--json"]
    )
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["left_out"] == {}
    assert all(Path(file).is_file() for file in said["files"])
    return folder / "robot"


def test_it_drives_a_robot_that_has_numpy_and_nothing_else_of_the_house(exported: Path) -> None:
    packages = str(Path(np.__file__).parents[1])
    run = [sys.executable, "-S", "-c", DRIVE, str(exported), packages]
    done = subprocess.run(run, capture_output=True, text=True, env={"PATH": ""}, cwd="/")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["apart"] < 1e-5
    assert found["house"] == []


def test_the_guides_lines_drive(exported: Path) -> None:
    (fence,) = fences_of("docs/your-policies.md", "A policy on a robot", "python")
    told: list[tuple[float, float]] = []
    given = {"ranges": np.full(360, 4.0), "drive": lambda v, w: told.append((v, w))}
    exec(fence.text.replace('"DIR"', repr(str(exported))), given)
    assert len(told) == 1
    assert 0 < told[0][0] <= 1


def test_the_product_itself_loads_the_room_without_what_takes_seconds() -> None:
    tell = (
        "import sys, desirepath.deploy.controller; print([m for m in sys.modules if m in ('torch', 'numba', 'scipy')])"
    )
    done = subprocess.run([sys.executable, "-c", tell], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_its_vectors_hold_for_the_onnx_graph_alone(exported: Path) -> None:
    vectors = json.loads((exported / "test_vectors.json").read_bytes())["vectors"]
    assert len(vectors) == 10
    session = onnxruntime.InferenceSession((exported / "policy.onnx").read_bytes())
    observed = np.array([one["observation"] for one in vectors], dtype=np.float32)
    actions = session.run(None, {"observation": observed})[0]
    np.testing.assert_allclose(actions, [one["action"] for one in vectors], atol=1e-5)
    commands = np.array([[one["command"]["v"], one["command"]["w"]] for one in vectors])
    np.testing.assert_allclose(commands[:, 0], (actions[:, 0] + 1) / 2, atol=1e-5)
    assert len({tuple(one["goal"]) for one in vectors}) == 10
    assert (exported / "recovery_1.onnx").is_file()
    assert (exported / "recovery_2.onnx").is_file()


def test_it_brings_every_file_that_its_program_names(files: dict[str, bytes]) -> None:
    """Modules that any of its modules imports, also where ROS is needed, and files that one reads from beside it."""
    program = {name.removesuffix("/__init__.py").removesuffix(".py"): name for name in files if name.endswith(".py")}
    assert "desirepath/deploy/ros/__main__" in program
    for name in program.values():
        for node in ast.walk(ast.parse(files[name])):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("desirepath"):
                module = str(node.module).replace(".", "/")
                inside = {f"{module}/{alias.name}" for alias in node.names}
                assert module in program or inside <= set(program), (name, node.module)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "with_name":
                beside = PurePosixPath(name).with_name(ast.literal_eval(node.args[0]))
                assert str(beside) in files, (name, str(beside))


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return bundle_files(load_policy("study_room/base"))


def changed(files: dict[str, bytes], change: dict[str, Any]) -> bytes:
    """The bundle with other fields in its manifest, by dotted path; ABSENT: without it."""
    said = json.loads(files["manifest.json"])
    for path, value in change.items():
        *into, last = path.split(".")
        at = said
        for step in into:
            at = at[int(step)] if isinstance(at, list) else at[step]
        if value is ABSENT:
            del at[last]
        else:
            at[int(last) if isinstance(at, list) else last] = value
    return zipped(files | {"manifest.json": json.dumps(said).encode()})


ABSENT = object()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lidar": ABSENT}, "'lidar' = None: must be an object"),
        ({"lidar.beams": 10**9}, "'lidar.beams' = 1000000000"),
        ({"lidar.beams": 0}, "'lidar.beams' = 0"),
        ({"lidar.beams": True}, "'lidar.beams' = True"),
        ({"lidar.sectors": 59}, "'lidar.sectors' = 59: must divide"),
        ({"lidar.sectors": 30}, "must end with lidar_0 to lidar_29"),
        ({"lidar.range_m": -1}, "'lidar.range_m' = -1"),
        ({"lidar.field_of_view_rad": 1e-3}, "'lidar.field_of_view_rad'"),
        ({"lidar.mounted_at": [0, 0]}, "'lidar.mounted_at'"),
        ({"observation.layout.3.name": "goal_distance"}, "'the same name'"),
        ({"observation.layout.0.name": "velocity"}, "must have goal_distance"),
        ({"observation.layout.0.divided_by": 0}, "'layout.divided_by' = 0"),
        ({"observation.layout": [{}] * 9_000}, "1 to 8,000 inputs"),
        ({"observation.layout.0": 7}, "must be objects"),
        ({"observation.shape": [3]}, "'observation.shape'"),
        ({"action.layout.0.range": [-1, 1]}, "'action.layout.range'"),
        ({"action.layout.1.range": [0, 1]}, "'action.layout.range'"),
        ({"action.layout": []}, "'action.layout'"),
        ({"control_rate_hz": 1e9}, "'control_rate_hz'"),
        ({"robot.radius_m": "x" * 500}, "'robot.radius_m'"),
        ({"robot.v_change": 0}, "'robot.v_change' = 0"),
        ({"robot.footprint": [[0, 0]]}, "'robot.footprint'"),
        ({"recovery": {"patience_s": 1}}, "'recovery.closer_m'"),
        ({"recovery": {"patience_s": 6, "closer_m": 0.1, "free_m": 0.5}}, "'recovery' must be there if"),
        ({"policy_sha256": "0" * 64}, "do not belong together"),
        ({"conditioning": {"kind": "mood"}}, "conditioning.kind = 'mood'"),
        ({"conditioning": {"kind": "shares", "objectives": ["a"]}}, "others than the policy's own"),
    ],
)
def test_a_manifest_that_cannot_be_is_refused(files: dict[str, bytes], change: dict[str, Any], said: str) -> None:
    with pytest.raises(BundleError, match=said):
        Bundle.read(changed(files, change))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", "no JSON"),
        (b"[]", "must be an object, is list"),
        (b'{"a": NaN}', "NaN is no number of JSON"),
        (b"[" * 100_000, "no JSON"),
        (b" " * (2**20 + 1), "at most 1,048,576"),
    ],
)
def test_a_manifest_that_is_none_is_refused(files: dict[str, bytes], content: bytes, said: str) -> None:
    with pytest.raises(BundleError, match=said):
        Bundle.read(zipped(files | {"manifest.json": content}))


def with_policy(files: dict[str, bytes], header: dict[str, Any], arrays: dict[str, np.ndarray]) -> bytes:
    """The bundle with another policy, whose hash its manifest says."""
    content = to_npz(header, arrays)
    return changed(files | {"policy.npz": content}, {"policy_sha256": hashlib.sha256(content).hexdigest()})


def test_a_policy_that_cannot_drive_is_refused(files: dict[str, bytes]) -> None:
    header, arrays = from_npz(files["policy.npz"])
    actor = {name: array for name, array in arrays.items() if name.startswith("actor")}
    last = max(actor)
    Bundle.read(with_policy(files, header, actor))
    for other, there, said in (
        ({"format": "desirepath-depth-1"}, actor, "format 'desirepath-depth-1'; what can be driven by"),
        ({}, {}, "network 'actor' is missing"),
        ({}, actor | {"actor_00": actor["actor_00"][:-1]}, "a layer of shape"),
        ({}, actor | {"actor_00": actor["actor_00"].astype(np.float64)}, "float32 by turns"),
        ({}, actor | {"actor_01": actor["actor_01"] * np.nan}, "NaN or infinite"),
        ({}, actor | {last: np.zeros(3, np.float32)}, "biases where"),
        ({}, actor | {"actor_99": actor[last]}, "weight and bias"),
        ({}, {f"actor_{k:02d}": actor["actor_01"] for k in range(90)}, "90 arrays"),
        ({"shape": {"extractor": 0}}, actor, "a layer of shape"),
        ({"slowing": {"most": 7}}, actor, "most = 7"),
        ({"slowing": {"speed": 1}}, actor, "slowing: "),
        ({"slowing": [1]}, actor, "must be an object"),
        ({"format": "desirepath-conditioned-1"}, actor, "'conditioning' must say"),
        ({"format": "desirepath-foreign-1"}, actor, "'network' of bytes is missing"),
        ({"format": "desirepath-foreign-1"}, {"network": np.zeros(9, np.uint8)}, "cannot be read as ONNX"),
    ):
        with pytest.raises(BundleError, match=said):
            Bundle.read(with_policy(files, header | other, there))


def network(*nodes: onnx.NodeProto, weights: onnx.TensorProto, rows: int | str = "n") -> np.ndarray:
    """Of a policy of others, as its file holds it."""
    given, actions = (
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [rows, size])
        for name, size in (("observation", 66), ("action", 2))
    )
    graph = onnx.helper.make_graph(list(nodes), "network", [given], [actions], [weights])
    opset = onnx.helper.make_opsetid("", 17)
    made = onnx.helper.make_model(graph, opset_imports=[opset], ir_version=9)
    return np.frombuffer(made.SerializeToString(), dtype=np.uint8)


def test_a_network_of_others_is_run_only_where_all_of_it_is_inside(
    files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = {"format": "desirepath-foreign-1", "setup": "study_room"}
    product = onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])
    inside = onnx.numpy_helper.from_array(np.zeros((66, 2), np.float32), "w")
    for rows in ("n", 1, 4):
        found = Bundle.read(with_policy(files, header, {"network": network(product, weights=inside, rows=rows)}))
        assert found.at({}).networks[0](np.ones((1, 66), np.float32)).tolist() == [[0.0, 0.0]]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(66 * 2 * 4))
    outside = onnx.TensorProto(name="w", data_type=onnx.TensorProto.FLOAT, dims=[66, 2], data_location=1)
    outside.external_data.add(key="location", value="weights.bin")
    wide = onnx.numpy_helper.from_array(np.zeros((66, 3), np.float32), "w")
    for weights, said in ((outside, "weights in other files"), (wide, "cannot be r(ead|un)|shape")):
        with pytest.raises(BundleError, match=said):
            Bundle.read(with_policy(files, header, {"network": network(product, weights=weights)}))


def test_what_is_no_bundle_is_refused(files: dict[str, bytes], tmp_path: Path) -> None:
    whole = zipped(files)
    with pytest.raises(BundleError, match=r"cannot read the bundle .*nowhere: No such file"):
        Bundle.read(tmp_path / "nowhere")
    with pytest.raises(BundleError, match="cannot read the bundle"):
        Bundle.read(tmp_path)
    for content in (b"", b"PK", whole[: len(whole) // 2], whole[:-30]):
        with pytest.raises(BundleError, match="is no zip that can be read"):
            Bundle.read(content)
    with pytest.raises(BundleError, match=r"lacks manifest\.json or policy\.npz"):
        Bundle.read(zipped({"manifest.json": b"{}"}))
    with pytest.raises(BundleError, match=r"manifest\.json: 2,000,000 bytes when unpacked"):
        Bundle.read(zipped({"manifest.json": b" " * 2_000_000, "policy.npz": b""}))
    damaged = bytearray(whole)
    place = whole.index(b"policy.npz") + 200
    damaged[place : place + 40] = b"x" * 40
    with pytest.raises(BundleError, match=r"no zip that can be read|policy.npz"):
        Bundle.read(bytes(damaged))


def test_weights_of_a_bundle_are_checked() -> None:
    files = bundle_files(load_conditioned("open_field/conditioned"))
    taken = json.loads(files["manifest.json"])["conditioning"]
    for other, said in (
        ({"objectives": []}, "1 to 40 names"),
        ({"objectives": taken["objectives"][::-1]}, "others than the policy's own"),
        ({"opposites": [["farther", "nearer"]]}, "opposites: must be objectives"),
        ({"opposites": [["farther"]]}, "pairs of names"),
        ({"weights": {"farther": 2}}, "farther = 2"),
        ({"weights": {"farther": "much"}}, "must be numbers by objective"),
    ):
        with pytest.raises(BundleError, match=said):
            Bundle.read(changed(files, {"conditioning": taken | other}))


def test_the_program_needs_no_newer_python_than_a_robot_has() -> None:
    """Its syntax is that of 3.10; ruff and mypy read it so, too (`pyproject.toml`, `Makefile`)."""
    import ast

    package = Path(desirepath.deploy.__file__).parents[1]
    for file in [*package.glob("deploy/*.py"), package / "npz.py", package / "zip_files.py"]:
        ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 10))
