"""Code that decides has a part in the fingerprint, however deep it is imported; other code has none."""

from pathlib import Path

import pytest

import learning
from learning.code_fingerprint import code_fingerprint

SOURCES = {
    "a.py": "from learning.b import one\n",
    "b.py": "def one():\n    from learning.c import deep\n",
    "c/__init__.py": "from learning.c import deep\n",
    "c/deep.py": "import json\n",
    "d.py": "from learning.a import one\n",
}


@pytest.mark.parametrize(
    ("changed", "decides"),
    [("a.py", True), ("b.py", True), ("c/__init__.py", True), ("c/deep.py", True), ("d.py", False)],
)
def test_all_that_is_imported_decides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str, decides: bool
) -> None:
    monkeypatch.setattr(learning, "__path__", [str(tmp_path)])
    (tmp_path / "c").mkdir()
    for name, text in SOURCES.items():
        (tmp_path / name).write_text(text)
    code_fingerprint.cache_clear()
    before = code_fingerprint("learning.a")
    (tmp_path / changed).write_text(SOURCES[changed] + "x = 1\n")
    code_fingerprint.cache_clear()
    after = code_fingerprint("learning.a")
    code_fingerprint.cache_clear()
    assert (before != after) == decides


def test_a_module_that_is_none_is_refused() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"learning\.gone"):
        code_fingerprint("learning.gone")
