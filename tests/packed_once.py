"""Query sets that come with the product, unpacked and packed again once for all studies of a package's tests.

Every study that a test creates takes its set's hundreds of trajectories into a store of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import pytest

from desirepath.learning.queries.queries import QuerySet
from desirepath.simulation.trajectory import Trajectory


@pytest.fixture(scope="package", autouse=True)
def packed_once() -> Iterator[None]:
    pack = Trajectory.to_bytes

    def packed(self: Trajectory) -> bytes:
        if "packed" not in self.__dict__:
            object.__setattr__(self, "packed", pack(self))  # frozen: what is packed never changes
        return self.__dict__["packed"]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(QuerySet, "from_bytes", lru_cache(maxsize=8)(QuerySet.from_bytes))
        patched.setattr(Trajectory, "to_bytes", packed)
        yield
