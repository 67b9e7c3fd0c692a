"""The house is as docs/architecture.md draws it: no circles of imports, no arrow upwards, no link to nowhere."""

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]
PACKAGES = ("simulator", "scenes", "psf_library", "learning")
GROUND = {
    "types",
    "arrays",
    "errors",
    "seeds",
    "text",
    "settings",
    "colour",
    "validation",
    "plugins",
    "plugin_listing",
    "entry_points",
}
BUILT = {"ground", "io", "config", "optics", "error_budget", "design", "camera", "render"}
MAY_IMPORT = {  # besides its own files
    "ground": {"io"},
    "io": {"ground"},
    "optics": {"ground", "io"},
    "error_budget": {"ground", "io", "optics"},
    "design": {"ground", "io", "optics"},
    "camera": {"ground", "io", "optics"},
    "calibrate": {"ground", "io", "optics"},
    "render": {"ground", "io"},
    "importers": {"ground", "io", "config", "assembly", "dataset"},
    "config": {"ground", "io", "camera", "optics"},
    "assembly": BUILT,
    "dataset": BUILT | {"assembly"},
}


def _modules() -> dict[str, Path]:
    files = [file for package in PACKAGES for file in (TOP / package).rglob("*.py")]
    return {".".join(file.relative_to(TOP).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


def _imports(file: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yield what a file imports of our own, wherever in it: at the top, for types only, inside functions."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                part = f"{node.module}.{alias.name}"
                yield part if part in known else node.module


def _room(module: str) -> str:
    package, _, rest = module.partition(".")
    first = rest.partition(".")[0]
    if package != "simulator":
        return package
    if first in GROUND or not first:
        return "ground"
    if first in ("assembly", "simulated_field", "captured_psf", "measured_psf"):
        return "assembly"
    return "error_budget" if rest.startswith("optics.error_budget") else first


@pytest.fixture(scope="module")
def arrows() -> dict[str, set[str]]:
    known = _modules()
    return {module: set(_imports(file, known)) - {module} for module, file in known.items()}


def test_imports_have_no_circles(arrows: dict[str, set[str]]) -> None:
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_no_arrow_leads_upwards(arrows: dict[str, set[str]]) -> None:
    wrong = []
    for module, targets in arrows.items():
        room = _room(module)
        allowed = MAY_IMPORT.get(room)
        for target in targets:
            if (allowed is not None and _room(target) not in allowed | {room}) or (
                module.startswith("simulator") and not target.startswith("simulator")
            ):
                wrong.append(f"{module} -> {target}")
    assert not wrong


PAGES = [
    TOP / "README.md",
    TOP / "CONTRIBUTING.md",
    TOP / "benchmarks" / "README.md",
    *sorted((TOP / "docs").rglob("*.md")),
]


def _places(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts name them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(TOP).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    """Where the repository is read; the site follows its own links when it is built."""
    lost = []
    for path, place in re.findall(
        r"\]\((?!https?://|mailto:)([^)#\s]*)#?([^)\s]*)\)", page.read_text(encoding="utf-8")
    ):
        target = page.parent / path if path else page
        if not target.exists() or (place and place not in _places(target)):
            lost.append(f"{path}#{place}")
    assert lost == []
