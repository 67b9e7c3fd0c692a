"""Fixtures of the simulator's tests."""

import hashlib
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

MAIN = "from simulator.cli import main; main()"


@pytest.fixture(scope="session")
def command() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Return a function that runs the command ``flatlight`` in a process of its own."""

    def run(*arguments: object, before: str = "", **options: Any) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-c", f"{before}\n{MAIN}", *map(str, arguments)]
        return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False, **options)

    return run


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that installs a package, its entry points declared as pip would leave them."""

    def install_package(package: str, entry_points: str, **modules: str) -> None:
        site = tmp_path / f"site_{package}"
        (site / package).mkdir(parents=True)
        for name, source in {"__init__": "", **modules}.items():
            (site / package / f"{name}.py").write_text(textwrap.dedent(source), encoding="utf-8")
        info = site / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
        (info / "entry_points.txt").write_text(textwrap.dedent(entry_points), encoding="utf-8")
        monkeypatch.syspath_prepend(str(site))

    return install_package


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """The address of an empty bucket in an S3 server on this machine, which the environment says how to reach."""
    import socket
    import urllib.request

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{probe.getsockname()[1]}"
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", url.rpartition(":")[2]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    access = {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "us-east-1"}
    try:
        end = time.monotonic() + 30
        while server.poll() is None:
            try:
                urllib.request.urlopen(urllib.request.Request(f"{url}/flatlight-test", method="PUT"))
                break
            except OSError:
                assert time.monotonic() < end, "the server did not start"
                time.sleep(0.05)
        with pytest.MonkeyPatch.context() as patch:
            for name, value in {**access, "AWS_ENDPOINT_URL": url, "AWS_ALLOW_HTTP": "true"}.items():
                patch.setenv(name, value)
            yield "s3://flatlight-test"
    finally:
        server.kill()
        server.wait()


@pytest.fixture(scope="session")
def decided() -> Callable[[Any], dict[str, str]]:
    """Return a function: a data set to what its seed decides, the SHA-256 of its files and its manifest's entries.

    Left out are the files that tell times, places and workers.
    """
    from simulator.dataset.manifest import load_manifest
    from simulator.io.store import relative_name

    told = ("dataset.json", "manifest.jsonl", "checksums.json", "croissant.json", "README.md", "report.html")

    def find(root: Any) -> dict[str, str]:
        files = (path for path in sorted(root.rglob("*.*")) if path.is_file() and path.name not in told)
        found = {relative_name(path, root): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
        entries = load_manifest(root).entries.items()
        return found | {"/".join(key): f"{one.digest} {one.seed} {one.label}" for key, one in entries}

    return find


@pytest.fixture(scope="session")
def tree() -> Callable[[Path], dict[str, str]]:
    """Return a function: a folder to everything in it, files with the SHA-256 of their content."""

    def find(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): "" if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()
            for path in folder.rglob("*")
            if "__pycache__" not in path.parts
        }

    return find


@pytest.fixture
def samples(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The helpers in samples.py."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    import samples  # type: ignore[import-not-found]

    yield samples
    sys.modules.pop("samples")


@pytest.fixture
def dataset(samples: ModuleType, tmp_path: Path) -> Path:
    """A small whole data set on disk."""
    return samples.make_dataset(tmp_path / "set")


@pytest.fixture
def clips(samples: ModuleType, tmp_path: Path) -> Path:
    """The same of clips: samples of three frames with global measurements."""
    return samples.make_dataset(tmp_path / "clips", samples.make_clip_sample)
