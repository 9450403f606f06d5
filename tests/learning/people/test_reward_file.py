"""A fitted reward as a person: state dicts and ONNX files beside a manifest; what cannot be read says why."""

from __future__ import annotations

import json
import os
import pickle
import re
import resource
import signal
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper
from torch import nn

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign import limited
from desirepath.learning.foreign.onnx_bounds import check_network
from desirepath.learning.people.reward_file import read_reward, reward_of_store
from desirepath.learning.people.reward_inputs import quantities
from desirepath.learning.people.reward_manifest import MANIFEST_BYTES, pack, read_manifest
from desirepath.learning.people.reward_networks import open_reward
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.linear import fit_linear
from desirepath.simulation.setups import get_setup, preference_setups

PREFERENCE_SETUPS = preference_setups()

STUDY_ROOM = get_setup("study_room")

INPUTS = STUDY_ROOM.observation_size + 2
EXPORT = [{"of": "observation", "form": "export"}, {"of": "action", "form": "export"}]


def manifest(folder: Path, file: str, **more: Any) -> Path:
    path = folder / "somebody.json"
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": file, "inputs": EXPORT}
    path.write_text(json.dumps(stated | more))
    return path


def network() -> nn.Sequential:
    torch.manual_seed(4)
    return nn.Sequential(nn.Linear(INPUTS, 16), nn.LeakyReLU(0.01), nn.Linear(16, 1), nn.Tanh())


def test_a_state_dict_scores_as_its_network_does(tmp_path: Path, study_queries: QuerySet) -> None:
    net = network()
    torch.save(net.state_dict(), tmp_path / "weights.pt")
    person = read_reward(manifest(tmp_path, "weights.pt", output="tanh"), "study_room")
    trajectory = study_queries.queries[0].trajectory_a
    with torch.no_grad():
        steps = net(torch.as_tensor(np.concatenate([trajectory.observations, trajectory.actions], axis=1)))
    assert person.score(trajectory) == pytest.approx(float(steps.mean()), abs=1e-5)


def onnx_of(nodes: list[Any], weights: dict[str, np.ndarray], width: int = INPUTS, **more: Any) -> Any:
    """A network of one input `x` (n, width) and one output `y`."""
    given = helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, ["n", width])
    found = helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, ["n", 1])
    stored = [numpy_helper.from_array(array, name) for name, array in weights.items()]
    graph = helper.make_graph(nodes, "reward", [given], [found], stored, **more)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)


def test_an_onnx_file_scores_as_its_network_does(tmp_path: Path, study_queries: QuerySet) -> None:
    weights = np.linspace(-1, 1, INPUTS, dtype=np.float32)[:, None]
    model = onnx_of([helper.make_node("MatMul", ["x", "w"], ["y"])], {"w": weights})
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    person = read_reward(manifest(tmp_path, "net.onnx", reduction="sum"), "study_room")
    trajectory = study_queries.queries[0].trajectory_a
    inputs = np.concatenate([trajectory.observations, trajectory.actions], axis=1)
    assert person.score(trajectory) == pytest.approx(float((inputs @ weights).sum()), rel=1e-3)


def test_what_torch_exports_is_read(tmp_path: Path, study_queries: QuerySet) -> None:
    """Linear layers and activations, as `torch.onnx` writes them, with dynamic batch."""
    pieces = [("Gemm", "x", "h", 16), ("LeakyRelu", "h", "a", 0), ("Gemm", "a", "o", 1), ("Tanh", "o", "y", 0)]
    net, nodes, weights, before = network(), [], {}, INPUTS
    for k, (kind, given, found, size) in enumerate(pieces):
        if size:
            layer = net[k]
            weights |= {f"w{k}": layer.weight.detach().numpy(), f"b{k}": layer.bias.detach().numpy()}
            nodes.append(helper.make_node(kind, [given, f"w{k}", f"b{k}"], [found], transB=1))
            before = size
        else:
            nodes.append(helper.make_node(kind, [given], [found]))
    assert before == 1
    (tmp_path / "net.onnx").write_bytes(onnx_of(nodes, weights).SerializeToString())
    torch.save(net.state_dict(), tmp_path / "net.pt")
    trajectory = study_queries.queries[0].trajectory_a
    ours = read_reward(manifest(tmp_path, "net.onnx"), "study_room").score(trajectory)
    assert ours == pytest.approx(
        read_reward(manifest(tmp_path, "net.pt", output="tanh"), "study_room").score(trajectory), abs=1e-5
    )


def hostile() -> dict[str, tuple[Any, str]]:
    """Name -> (network, what is said of it)."""
    one = np.ones((INPUTS, 1), np.float32)
    summed = [helper.make_node("MatMul", ["x", "w"], ["y"])]
    body = helper.make_graph(
        [helper.make_node("Identity", ["c"], ["d"])], "body",
        [helper.make_tensor_value_info("i", onnx.TensorProto.INT64, []),
         helper.make_tensor_value_info("c", onnx.TensorProto.BOOL, [])],
        [helper.make_tensor_value_info("d", onnx.TensorProto.BOOL, [])],
    )  # fmt: skip
    forever = {"m": np.array(2**62, np.int64), "t": np.array(True), "w": one}
    large = {"s": np.array([2**29], np.int64), "w": one}
    doubling = [helper.make_node("Concat", ["x", "x"], ["z0"], axis=1)]
    doubling += [helper.make_node("Concat", [f"z{k}", f"z{k}"], [f"z{k + 1}"], axis=1) for k in range(30)]
    spread = [helper.make_node("Add", ["x", "wide"], ["b"]), helper.make_node("ReduceMean", ["b"], ["y"], axes=[0, 2])]
    elsewhere = onnx_of(summed, {"w": one})
    stored = elsewhere.graph.initializer[0]
    stored.ClearField("raw_data")
    stored.data_location = onnx.TensorProto.EXTERNAL
    for key, value in (("location", "../../etc/passwd"), ("offset", "0"), ("length", str(4 * INPUTS))):
        entry = stored.external_data.add()
        entry.key, entry.value = key, value
    short = onnx_of(summed, {"w": one})
    short.graph.initializer[0].dims[:] = [INPUTS, 1_000_000_000]
    twice = helper.make_node(
        "Constant", [], ["wide"], value=numpy_helper.from_array(np.ones((30_000, 1, 1), np.float32))
    )
    twice.attribute.append(helper.make_attribute("value", numpy_helper.from_array(np.ones((1, 1, 1), np.float32))))
    of_function = onnx_of([helper.make_node("Own", ["x"], ["y"], domain="own")], {})
    return {
        "external data": (elsewhere, "another file"),
        "a loop": (onnx_of([helper.make_node("Loop", ["m", "t"], [], body=body), *summed], forever), "Loop is not run"),
        "much of little": (
            onnx_of([helper.make_node("ConstantOfShape", ["s"], ["z"]), *summed], large), "ConstantOfShape is not run"
        ),
        "doubling": (onnx_of([*doubling, *summed], {"w": one}), "per step"),
        "broadcasting": (onnx_of(spread, {"wide": np.ones((400_000, 1, 1), np.float32)}), "per step"),
        "large and small by the same name": (onnx_of([twice, *spread], {}), "an attribute twice"),
        "dimensions without numbers": (short, "dimension"),
        "an operator of its own": (of_function, "own.Own is not run"),
        "a size decided by values": (
            onnx_of([helper.make_node("NonZero", ["x"], ["z"]), *summed], {"w": one}), "NonZero is not run"
        ),
        "two rewards": (onnx_of(summed, {"w": np.ones((INPUTS, 2), np.float32)}), "an output (n, 1)"),
        "another width": (onnx_of(summed, {"w": np.ones((5, 1), np.float32)}, width=5), f"inputs are {INPUTS}"),
    }  # fmt: skip


HOSTILE = hostile()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_network_that_could_harm_is_refused_before_it_runs(name: str) -> None:
    model, said = HOSTILE[name]
    with pytest.raises(LearningError, match=re.escape(said)):
        check_network(model.SerializeToString(), INPUTS, "net.onnx")


MIXING = {
    "softmax": [helper.make_node("Softmax", ["z"], ["y"], axis=0)],
    "mean": [helper.make_node("ReduceMean", ["z"], ["m"], axes=[0]), helper.make_node("Sub", ["z", "m"], ["y"])],
    "first": [helper.make_node("Gather", ["z", "i"], ["f"], axis=0), helper.make_node("Add", ["z", "f"], ["y"])],
}


@pytest.mark.parametrize("name", MIXING)
def test_the_reward_of_a_step_is_its_own(name: str) -> None:
    """Steps are asked together with others, the last ones with zeros that fill up."""
    weights = {"w": np.ones((INPUTS, 1), np.float32), "i": np.array([1], np.int64)}
    content = onnx_of([helper.make_node("MatMul", ["x", "w"], ["z"]), *MIXING[name]], weights).SerializeToString()
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.onnx", "inputs": EXPORT}
    mixing = read_manifest(json.dumps(stated).encode(), "manifest")
    with pytest.raises(LearningError, match="changes with the steps that are asked beside it"):
        open_reward(mixing.model_dump_json().encode(), content)


def test_what_takes_too_long_or_too_much_ends_its_own_process_alone(tmp_path: Path, monkeypatch: Any) -> None:
    weights = np.ones((INPUTS, 1), np.float32)
    (tmp_path / "net.onnx").write_bytes(
        onnx_of([helper.make_node("MatMul", ["x", "w"], ["y"])], {"w": weights}).SerializeToString()
    )
    person = read_reward(manifest(tmp_path, "net.onnx"), "study_room")
    reward = person.reward
    assert reward(np.ones((3, INPUTS), np.float32)).tolist() == [[INPUTS]] * 3
    os.kill(reward._process.pid, signal.SIGSTOP)  # as a network that never ends
    monkeypatch.setattr(limited, "ANSWER_S", 0.3)
    with pytest.raises(LearningError, match="took longer"):
        reward(np.ones((1, INPUTS), np.float32))
    monkeypatch.setattr(limited, "ANSWER_S", 60.0)
    with pytest.raises(LearningError, match="was ended by signal 9"):
        reward(np.ones((1, INPUTS), np.float32))
    reward.close()


def test_the_process_has_little_memory_no_files_and_ends_with_its_reader(tmp_path: Path) -> None:
    torch.save(nn.Linear(INPUTS, 1).state_dict(), tmp_path / "net.pt")
    person = read_reward(manifest(tmp_path, "net.pt"), "study_room")
    process = person.reward._process.pid
    assert resource.prlimit(process, resource.RLIMIT_AS)[0] == limited.MEMORY_BYTES
    assert resource.prlimit(process, resource.RLIMIT_FSIZE) == (0, 0)
    assert resource.prlimit(process, resource.RLIMIT_CPU)[0] == limited.CPU_S
    cast(IO[bytes], person.reward._process.stdin).close()  # as the end of whoever asked it does
    person.reward._process.wait(20)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


# ---- what its inputs mean --------------------------------------------------------------------------------------------

SI = [
    {"of": "observation", "form": "si", "lidar": {"first_deg": 180, "turns": "clockwise"}},
    {"of": "action", "form": "si"},
]


def test_raw_si_units_and_a_scan_from_behind_are_converted(study_queries: QuerySet) -> None:
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.onnx", "inputs": SI}
    read = read_manifest(json.dumps(stated).encode(), "somebody.json")
    trajectory = study_queries.queries[0].trajectory_a
    ours = np.concatenate([trajectory.observations, trajectory.actions], axis=1)
    theirs = read.conversion(ours)
    layout = STUDY_ROOM.observation_layout()
    goal = next(k for k, one in enumerate(layout) if one["name"] == "goal_distance")
    assert theirs[:, goal] == pytest.approx(ours[:, goal] * STUDY_ROOM.distance_scale_m, rel=1e-5)
    first = STUDY_ROOM.polar_size
    scan = ours[:, first : first + STUDY_ROOM.robot.lidar.sectors] * STUDY_ROOM.robot.lidar.range_m
    behind = STUDY_ROOM.robot.lidar.sectors // 2
    assert theirs[:, first] == pytest.approx(scan[:, behind - 1], rel=1e-5)  # clockwise from behind: the left side
    assert theirs[:, first + 1] == pytest.approx(scan[:, behind - 2], rel=1e-5)
    speed = theirs[:, STUDY_ROOM.observation_size]
    commanded = STUDY_ROOM.robot.limits.v_min + (ours[:, -2] + 1) / 2 * (
        STUDY_ROOM.robot.limits.v_max - STUDY_ROOM.robot.limits.v_min
    )
    assert speed == pytest.approx(commanded, abs=1e-5)


def test_the_exports_own_form_is_taken_as_it_is(study_queries: QuerySet) -> None:
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.onnx", "inputs": EXPORT}
    trajectory = study_queries.queries[0].trajectory_a
    ours = np.concatenate([trajectory.observations, trajectory.actions], axis=1)
    assert np.allclose(read_manifest(json.dumps(stated).encode(), "x").conversion(ours), ours, atol=1e-6)


def column(name: str, unit: str, scale: float = 1.0, offset: float = 0.0) -> dict[str, Any]:
    return {"name": name, "unit": unit, "scale": scale, "offset": offset}


def test_single_columns_have_a_unit_scale_and_offset_of_their_own(study_queries: QuerySet) -> None:
    columns = [column("goal_bearing", "deg"), column("person_distance", "cm", 0.01, -1.0), column("lidar", "m", 2.0)]
    inputs = [{"of": "observation", "columns": columns, "lidar": {"first_deg": 0, "turns": "counter_clockwise"}}]
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.onnx", "inputs": inputs}
    read = read_manifest(json.dumps(stated).encode(), "x")
    assert read.width == 2 + STUDY_ROOM.robot.lidar.sectors
    ours = study_queries.queries[0].trajectory_a.observations
    names = [one["name"] for one in STUDY_ROOM.observation_layout()]
    theirs = read.conversion(ours)
    assert theirs[:, 0] == pytest.approx(ours[:, names.index("goal_bearing")] * 180, rel=1e-4, abs=1e-3)
    person = ours[:, names.index("person_distance")] * STUDY_ROOM.distance_scale_m
    assert theirs[:, 1] == pytest.approx(person - 1.0, abs=1e-4)
    assert theirs[:, 2] == pytest.approx(2 * ours[:, names.index("lidar_0")] * STUDY_ROOM.robot.lidar.range_m, rel=1e-5)


@pytest.mark.parametrize(
    ("inputs", "said"),
    [
        (None, "inputs"),
        (["observation", "action"], "inputs"),
        ([{"of": "observation"}], "state either form"),
        ([{"of": "observation", "form": "si"}], "state the order of the scan"),
        ([{"of": "observation", "columns": [column("lidar", "m")]}], "state the order of the scan"),
        ([{"of": "observation", "columns": [{"name": "goal_distance", "unit": "m"}]}], "scale"),
        ([{"of": "observation", "columns": [column("goal_distance", "feet")]}], "must be one of m, cm, mm"),
        ([{"of": "observation", "columns": [column("goal", "m")]}], "must be one of goal_distance"),
        ([SI[0] | {"lidar": {"first_deg": 7, "turns": "clockwise"}}], "multiple of a sector's"),
        ([EXPORT[0] | {"lidar": {"first_deg": 0, "turns": "clockwise"}}], "export's own order"),
    ],
)
def test_what_is_not_stated_is_refused_and_says_what_would_work(inputs: Any, said: str) -> None:
    stated = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.onnx"}
    stated |= {"inputs": inputs} if inputs is not None else {}
    with pytest.raises(LearningError, match=re.escape(said)):
        read_manifest(json.dumps(stated).encode(), "somebody.json")


def test_a_reward_model_of_the_store_is_a_person(tmp_path: Path, study_queries: QuerySet) -> None:
    model = fit_linear(make_oracle("shortest").answer(study_queries.queries[:20]))
    model.save(tmp_path / "model.npz")
    trajectory = study_queries.queries[0].trajectory_a
    person = read_reward(tmp_path / "model.npz", "study_room")
    assert person.score(trajectory) == pytest.approx(model.trajectory_reward(trajectory))
    with pytest.raises(LearningError, match="open_field"):
        read_reward(tmp_path / "model.npz", "open_field")


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path("/tmp/desirepath-was-here").touch, ())


def test_nothing_pickled_is_run(tmp_path: Path) -> None:
    (tmp_path / "evil.pt").write_bytes(pickle.dumps({"0.weight": Evil()}))
    with pytest.raises(LearningError, match="not a state dict"):
        read_reward(manifest(tmp_path, "evil.pt"), "study_room")
    torch.save({"0.weight": Evil()}, tmp_path / "evil.pt")
    with pytest.raises(LearningError, match="not a state dict"):
        read_reward(manifest(tmp_path, "evil.pt"), "study_room")


def test_what_cannot_be_says_which_field_and_what_would_work(tmp_path: Path) -> None:
    torch.save(nn.Linear(5, 1).state_dict(), tmp_path / "small.pt")
    with pytest.raises(LearningError, match=f"\\(outputs, {INPUTS}\\)"):
        read_reward(manifest(tmp_path, "small.pt"), "study_room")
    torch.save(nn.Linear(INPUTS, 3).state_dict(), tmp_path / "three.pt")
    with pytest.raises(LearningError, match="3 outputs"):
        read_reward(manifest(tmp_path, "three.pt"), "study_room")
    with pytest.raises(LearningError, match="file"):
        read_reward(manifest(tmp_path, "../elsewhere.pt"), "study_room")
    with pytest.raises(LearningError, match="inputs"):
        read_reward(manifest(tmp_path, "small.pt", inputs=[{"of": "camera", "form": "si"}]), "study_room")
    with pytest.raises(LearningError, match="cannot read"):
        read_reward(manifest(tmp_path, "missing.onnx"), "study_room")
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    with pytest.raises(LearningError, match="ONNX"):
        read_reward(manifest(tmp_path, "broken.onnx"), "study_room")
    large = tmp_path / "large.json"
    large.write_text("[" * (MANIFEST_BYTES + 1))
    with pytest.raises(LearningError, match="at most"):
        read_reward(large, "study_room")
    large.write_text("[" * 5_000)
    with pytest.raises(LearningError, match="manifest"):
        read_reward(large, "study_room")


def test_manifest_and_network_are_one_file_of_the_store(tmp_path: Path, study_queries: QuerySet) -> None:
    net = network()
    torch.save(net.state_dict(), tmp_path / "weights.pt")
    path = manifest(tmp_path, "weights.pt", output="tanh")
    kept = pack(read_manifest(path.read_bytes(), "somebody.json"), (tmp_path / "weights.pt").read_bytes())
    trajectory = study_queries.queries[0].trajectory_a
    person = reward_of_store(kept, "study_room")
    assert person.score(trajectory) == read_reward(path, "study_room").score(trajectory)
    with pytest.raises(LearningError, match="open_field"):
        reward_of_store(kept, "open_field")
    with pytest.raises(LearningError, match="not a reward of the store"):
        reward_of_store(kept[:200], "study_room")
    with pytest.raises(LearningError, match="0 bytes"):
        pack(read_manifest(path.read_bytes(), "somebody.json"), b"")


def test_the_guide_lists_every_input_and_its_example_is_read() -> None:
    guide = (Path(__file__).resolve().parents[3] / "docs" / "your-policies.md").read_text(encoding="utf-8")
    part = guide[guide.index("## Inputs of a reward network") :]
    example = part[part.index("```json") + 7 : part.index("```", part.index("```json") + 7)]
    assert read_manifest(example.encode(), "guide").width == STUDY_ROOM.observation_size + 1
    for setup in PREFERENCE_SETUPS:
        (row,) = [line for line in part.splitlines() if line.startswith(f"| `{setup}` |")]
        names = [name for name in quantities(get_setup(setup), "observation") if not name.startswith("lidar")]
        assert [name for name in names if f"`{name}` (" not in row] == []
        assert f"`lidar_{get_setup(setup).robot.lidar.sectors - 1}`" in row
