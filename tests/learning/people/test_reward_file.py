"""A fitted reward as a person: state dicts and ONNX files beside a manifest; what cannot be read says why."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from backend.learning.errors import LearningError
from backend.learning.people.reward_file import read_reward, reward_of_store
from backend.learning.people.reward_manifest import MANIFEST_BYTES, kept_together, read_manifest
from backend.learning.preferences.oracles import make_oracle
from backend.learning.queries.queries import QuerySet
from backend.learning.rewards.linear import fit_linear
from backend.learning.rewards.storage import save_reward_model
from backend.simulation.setups import STUDY_ROOM

INPUTS = STUDY_ROOM.observation_size + 2


def manifest(folder: Path, file: str, **more: Any) -> Path:
    path = folder / "somebody.json"
    path.write_text(json.dumps({"format": "desirepath-reward-1", "setup": "study_room", "file": file} | more))
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


def test_an_onnx_file_scores_as_its_network_does(tmp_path: Path, study_queries: QuerySet) -> None:
    onnx = pytest.importorskip("onnx")
    weights = np.linspace(-1, 1, INPUTS, dtype=np.float32)[:, None]
    from onnx import helper, numpy_helper

    graph = helper.make_graph(
        [helper.make_node("MatMul", ["x", "w"], ["y"])],
        "reward",
        [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, ["n", INPUTS])],
        [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, ["n", 1])],
        [numpy_helper.from_array(weights, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    person = read_reward(manifest(tmp_path, "net.onnx", reduction="sum"), "study_room")
    trajectory = study_queries.queries[0].trajectory_a
    inputs = np.concatenate([trajectory.observations, trajectory.actions], axis=1)
    assert person.score(trajectory) == pytest.approx(float((inputs @ weights).sum()), rel=1e-3)


def test_a_reward_model_of_the_store_is_a_person(tmp_path: Path, study_queries: QuerySet) -> None:
    model = fit_linear(make_oracle("shortest").answer(study_queries.queries[:20]))
    save_reward_model(model, tmp_path / "model.npz")
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
        read_reward(manifest(tmp_path, "small.pt", inputs=["camera"]), "study_room")
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
    kept = kept_together(read_manifest(path.read_bytes(), "somebody.json"), (tmp_path / "weights.pt").read_bytes())
    trajectory = study_queries.queries[0].trajectory_a
    person = reward_of_store(kept, "study_room")
    assert person.score(trajectory) == read_reward(path, "study_room").score(trajectory)
    with pytest.raises(LearningError, match="open_field"):
        reward_of_store(kept, "open_field")
    with pytest.raises(LearningError, match="not a reward of the store"):
        reward_of_store(kept[:200], "study_room")
    with pytest.raises(LearningError, match="0 bytes"):
        kept_together(read_manifest(path.read_bytes(), "somebody.json"), b"")
