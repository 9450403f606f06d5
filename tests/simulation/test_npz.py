"""The file format of arrays with a header: the same bytes as ever; small files that would become large are refused."""

from __future__ import annotations

import contextlib
import io
import json
import random
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from desirepath.installed import DATASETS
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import Policy, PolicyError
from desirepath.learning.queries.queries import QuerySet
from desirepath.npz import Bounds, NpzError, from_npz, npz_header, to_npz
from desirepath.simulation.fast import rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

STUDY_ROOM = get_setup("study_room")

SHIPPED = sorted(DATASETS.glob("*/**/*.npz"))


def npy(text: str, content: bytes = b"") -> bytes:
    """An array file with a header of our own making."""
    header = text.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content


def zipped(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def meta(header: object) -> bytes:
    out = io.BytesIO()
    np.save(out, np.frombuffer(json.dumps(header).encode(), dtype=np.uint8))
    return out.getvalue()


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return rollout(
        STUDY_ROOM, lambda seen: np.tile(np.float32([0, 0.5]), (len(seen), 1)), draw_scenes("study_room", [3])
    )[0]


@pytest.mark.parametrize("path", SHIPPED, ids=[path.relative_to(DATASETS).as_posix() for path in SHIPPED])
def test_what_was_shipped_is_read_and_written_again_byte_for_byte(path: Path) -> None:
    content = path.read_bytes()
    header, arrays = from_npz(content)
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        assert list(stored) == ["meta", *arrays]
        for name, array in arrays.items():
            assert array.dtype == stored[name].dtype
            assert np.array_equal(array, stored[name])
            assert array.flags.writeable
    assert npz_header(content) == header
    assert to_npz(header, arrays) == content


def test_a_trajectory_is_read_and_written_again_byte_for_byte(trajectory: Trajectory) -> None:
    content = trajectory.to_bytes()
    assert Trajectory.from_bytes(content).to_bytes() == content
    assert to_npz(*from_npz(content)) == content


@pytest.mark.parametrize("name", ["poses", "observations", "actions", "rewards", "next_observations", "dones"])
def test_a_trajectory_whose_arrays_do_not_belong_together_is_refused(name: str, trajectory: Trajectory) -> None:
    header, arrays = from_npz(trajectory.to_bytes())
    for changed in (arrays[name][:-1], arrays[name][..., None], np.float32(0)):
        with pytest.raises(ValueError, match="not a desirepath trajectory"):
            Trajectory.from_bytes(to_npz(header, arrays | {name: np.asarray(changed)}))


@pytest.mark.parametrize("shape", [(), (0,), (0, 3), (4, 5), (2, 3, 4)])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", [np.float16, np.float64, np.int8, np.bool_, np.uint32])
def test_every_shape_and_order_comes_back(shape: tuple[int, ...], order: str, kind: type[np.generic]) -> None:
    array = np.asarray(np.random.default_rng(1).integers(0, 2, shape), order=order).astype(kind, order="K")
    content = to_npz({"a": 1}, {"array": array})
    header, arrays = from_npz(content)
    assert (header, arrays["array"].dtype, arrays["array"].shape) == ({"a": 1}, array.dtype, shape)
    assert np.array_equal(arrays["array"], array)
    assert to_npz(header, arrays) == content


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "File is not a zip file"),
        (b"x" * 1000, "File is not a zip file"),
        (zipped({"poses.npy": meta(1)}), "'meta.npy'"),
        (zipped({"meta.npy": meta([1])}), "the header is list, must be an object"),
        (zipped({"meta.npy": b"not an array"}), "magic string"),
        (zipped({"meta.npy": npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }")}), "numbers only"),
        (zipped({"meta.npy": npy("{'descr': '<U9', 'fortran_order': False, 'shape': (1,), }")}), "numbers only"),
        (
            zipped({"meta.npy": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (9000000000000,), }")}),
            "do not hold",
        ),
        (zipped({"meta.npy": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }")}), "do not hold"),
        (zipped({"meta.npy": npy("(" * 100)}), "EOF|parse"),
        (zipped({f"{n}.npy": b"" for n in range(1_001)}), "1001 arrays; at most 1000"),
        (zipped({"meta.npy": meta({})}, zipfile.ZIP_LZMA), "compressed otherwise"),
        (zipped({"meta.npy": meta(json.loads("[" * 400 + "]" * 400))}), "the header is list"),
    ],
)
def test_what_is_no_file_of_ours_is_refused_in_words(content: bytes, told: str) -> None:
    with pytest.raises(NpzError, match=told):
        from_npz(content)


def test_a_header_nested_without_end_is_refused() -> None:
    deep = b"[" * 200_000
    out = io.BytesIO()
    np.save(out, np.frombuffer(deep, dtype=np.uint8))
    with pytest.raises(NpzError):
        from_npz(zipped({"meta.npy": out.getvalue()}))


def test_a_small_file_does_not_become_gigabytes(trajectory: Trajectory) -> None:
    """Two kinds: zeros that are really there when unpacked, and a shape that is only said."""
    header = from_npz(trajectory.to_bytes())[0]
    large = zipped({"meta.npy": meta(header), "poses.npy": npy("{}") + bytes(2**28)})
    said = npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4000000000, 3), }", bytes(12))
    for content in (large, zipped({"meta.npy": meta(header), "poses.npy": said})):
        assert len(content) < 2**19
        tracemalloc.start()
        with pytest.raises(ValueError, match=r"not a desirepath trajectory \(.npz\)"):
            Trajectory.from_bytes(content)
        assert tracemalloc.get_traced_memory()[1] < 2**22
        tracemalloc.stop()


def test_bounds_are_the_callers() -> None:
    content = to_npz({"a": "x" * 200}, {"zeros": np.zeros(1_000)})
    assert from_npz(content)[1]["zeros"].shape == (1_000,)
    for bounds, told in (
        (Bounds(arrays=1), "2 arrays; at most 1"),
        (Bounds(header_bytes=100), "a header of 3"),
        (Bounds(all_bytes=1_000), "bytes when unpacked; at most 1000"),
    ):
        with pytest.raises(NpzError, match=told):
            from_npz(content, bounds)


def test_a_file_that_lies_about_its_sizes_is_refused() -> None:
    """The archive says ten bytes where there are a million: no more than ten are unpacked."""
    content = bytearray(zipped({"meta.npy": meta({}), "zeros.npy": npy("{}") + bytes(1_000_000)}))
    place = content.rindex(b"PK\x01\x02") + 24
    content[place : place + 4] = (10).to_bytes(4, "little")
    with pytest.raises(NpzError):
        from_npz(bytes(content))


@pytest.mark.parametrize("what", ["trajectory", "policy", "queries"])
def test_a_damaged_file_is_refused_and_nothing_else_happens(what: str, trajectory: Trajectory) -> None:
    """Bytes changed at random, a thousand times: what is read is whole, everything else is said to be none of ours."""
    content, read, refused = {
        "trajectory": (trajectory.to_bytes(), Trajectory.from_bytes, ValueError),
        "policy": ((DATASETS / "open_field" / "ensemble" / "0.npz").read_bytes(), Policy.from_bytes, PolicyError),
        "queries": (_few_queries().to_bytes(), QuerySet.from_bytes, LearningError),
    }[what]
    chance = random.Random(7)
    for _ in range(1_000):
        damaged = bytearray(content)
        for _ in range(chance.choice([1, 1, 2, 20])):
            place = chance.choice([chance.randrange(len(damaged)), len(damaged) - 1 - chance.randrange(900)])
            damaged[place] = chance.randrange(256)
        if chance.random() < 0.1:
            del damaged[chance.randrange(len(damaged)) :]
        with contextlib.suppress(refused):
            read(bytes(damaged))


def _few_queries() -> QuerySet:
    whole = QuerySet.load(DATASETS / "open_field" / "queries_varied_200.npz")
    return QuerySet(whole.setup, whole.queries[:3], whole.filtered)
