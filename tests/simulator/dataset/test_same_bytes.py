"""The same seed gives the same bytes: whatever the engine, its workers, the shards and the place."""

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest

from simulator.dataset import generate, verify
from simulator.dataset.shards import Shard
from simulator.io import store
from simulator.io.store import place

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 12, "validation": 4, "test": 4}
# Each engine with the place and shards that it might treat differently; one worker on the disk is what they are held to.
CASES = [
    ("disk", "local", 2, 1),
    ("disk", "inline", 1, 2),
    ("disk", "inline", 1, 5),
    ("store", "local", 2, 1),
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in [
            ("disk", "local", 1, 1),
            ("disk", "local", 4, 2),
            ("disk", "ray", 2, 1),
            ("store", "inline", 1, 5),
            ("store", "ray", 2, 2),
        ]
    ),
]
NUMBERS = count()


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable, contents: Callable) -> dict[str, str]:
    return contents(make_trial(tmp_path_factory.mktemp("expected")).generate(dataset=DATASET))


@pytest.fixture(scope="module")
def cluster(bucket: str, ray_cluster: None) -> None:
    """A Ray cluster whose workers find the bucket by their environment."""


@pytest.fixture
def fresh_clients() -> Iterator[None]:
    """A client of a store keeps the environment of its making."""
    store._client.cache_clear()
    yield
    store._client.cache_clear()


@pytest.mark.usefixtures("fresh_clients")
@pytest.mark.parametrize(("where", "engine", "workers", "shards"), CASES)
def test_same_seed_same_bytes(
    trial, request: pytest.FixtureRequest, expected, contents, where: str, engine: str, workers: int, shards: int
) -> None:
    if engine == "ray":
        request.getfixturevalue("cluster")
    root = trial.folder / "out"
    path: Path = trial.write(dataset=DATASET | {"engine": engine, "workers": workers})
    if where == "store":
        root = place(f"{request.getfixturevalue('bucket')}/sets/{next(NUMBERS)}")
        path.write_text(path.read_text().replace(str(trial.folder / "out"), str(root)))
    results = [generate(path, shard=Shard(index, shards) if shards > 1 else None) for index in range(shards)]
    assert sum(result.made for result in results) == 20
    assert (results[-1].path, results[-1].missing) == (root, 0)
    if where == "store" and shards > 1:  # where nothing tells a shard that it is the last
        assert (generate(path).made, results[-1].sealed) == (0, False)
    assert contents(root) == expected
    assert verify(root).ok
