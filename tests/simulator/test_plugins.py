"""The three ways to name a plugin, and what is wrong with the ones that are refused."""

import math
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from simulator.errors import InputError
from simulator.plugins import ParameterError, available, plugin_errors, resolve

Install = Callable[..., None]


@pytest.fixture(autouse=True)
def forget_modules() -> Iterator[None]:
    """Forget what a test imported, so that the next one may use the same names."""
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith(("trial_", "flatlight_plugin_")):
            del sys.modules[name]


def write(folder: Path, source: str, name: str = "my_mask.py") -> Path:
    path = folder / name
    path.write_text(textwrap.dedent(source), encoding="utf-8")
    return path


def refused(kind: str, name: str, base_dir: Path | None = None) -> str:
    with pytest.raises(InputError) as caught:
        resolve(kind, name, base_dir)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_new_file_in_a_package_is_a_new_design(install: Install) -> None:
    install(
        "trial_designs",
        "[flatlight.masks]\ntrial = trial_designs\n",
        whirl="def whirl(*, charge: int = 1):\n    return charge\n",
        helpers="def shared(): ...\n",  # nothing of its own name: no design
        _private="def _private(): ...\n",
        renamed="from trial_designs.helpers import shared as renamed\n",
        alias="alias = lambda: 1\n",
        broken="def broken(:\n",
    )
    names = available("mask")
    assert {"whirl", "renamed", "alias", "broken", "phlatcam"} <= set(names)  # with those that flatlight brings
    assert not {"helpers", "shared", "_private", "__init__"} & set(names)
    assert names == sorted(names)
    assert "trial_designs.whirl" not in sys.modules, "listing imports no design"
    plugin = resolve("mask", "whirl")
    assert plugin.function(**plugin.bind({"charge": 3})) == 3
    assert plugin.path is None
    assert "trial_designs.alias" not in sys.modules, "resolving imports no other design"
    assert "broken.py:1: SyntaxError" in refused("mask", "broken")


def test_scenes_and_sources_have_groups_of_their_own(install: Install) -> None:
    install(
        "trial_worlds",
        "[flatlight.scenes]\ntrial = trial_worlds\n[flatlight.sources]\ntrial = trial_worlds\n",
        room="def room(view, *, objects: int = 2, renderer: object): ...\n",
    )
    assert "room" in available("scene")
    assert "room" in available("source")
    assert "room" not in available("mask")
    assert "flyingthings3d" in available("source")  # simulator.importers needs no entry point
    plugin = resolve("scene", "room")
    assert plugin.takes_renderer
    assert plugin.bind({}) == {"objects": 2}
    assert refused("mask", "room").startswith("mask design: got 'room'")


def test_a_name_that_two_packages_define_is_refused(install: Install) -> None:
    install("trial_one", "[flatlight.masks]\none = trial_one\nagain = trial_one\n", helix="def helix(): ...\n")
    assert resolve("mask", "helix").bind({}) == {}
    message = refused("mask", "hleix")
    assert message.startswith("mask design: got 'hleix', expected one of ")
    assert message.endswith("did you mean 'helix'?")
    install("trial_two", "[flatlight.masks]\ntwo = trial_two\n", helix="def helix(): ...\n")
    message = refused("mask", "helix")
    assert message.startswith("mask design 'helix': ")
    assert "trial_one.helix and trial_two.helix" in message
    assert resolve("mask", "trial_two.helix:helix").function.__module__ == "trial_two.helix"


def test_an_entry_point_to_nowhere_is_named(install: Install) -> None:
    install("trial_one", "[flatlight.masks]\none = trial_nowhere\n")
    message = refused("mask", "helix")
    assert "'trial_nowhere', which an entry point names for masks" in message
    assert "ModuleNotFoundError" in message


def test_a_file_beside_the_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, "def vortex(*, charge: int = 1):\n    return charge\n")
    plugin = resolve("mask", "./my_mask.py:vortex", tmp_path)
    assert plugin.function(**plugin.bind({"charge": 2})) == 2
    assert plugin.path == path
    assert resolve("mask", f"{path}:vortex").path == path  # an absolute path
    monkeypatch.chdir(tmp_path)
    assert resolve("mask", "./my_mask.py:vortex").path == path  # no folder given: the current one
    assert resolve("mask", "./my_mask.py:vortex", tmp_path).function is plugin.function, "imported once"
    assert not (tmp_path / "__pycache__").exists()
    assert f"there is no file {tmp_path / 'none.py'}" in refused("scene", "./none.py:room", tmp_path)
    write(tmp_path, "def vortex(*, charge: int = 1.5): ...\n")
    with pytest.raises(ParameterError, match="charge:"):
        resolve("mask", "./my_mask.py:vortex", tmp_path).bind({})


def test_a_file_that_changed_is_read_again(tmp_path: Path) -> None:
    write(tmp_path, "def vortex(): return 1\n")
    assert resolve("mask", "./my_mask.py:vortex", tmp_path).function() == 1
    write(tmp_path, "def vortex(): return 22\n")
    assert resolve("mask", "./my_mask.py:vortex", tmp_path).function() == 22


def test_a_file_may_hold_dataclasses(tmp_path: Path) -> None:
    source = """
        from __future__ import annotations
        from dataclasses import dataclass

        @dataclass
        class Vortex:
            charge: int

        def vortex(*, charge: int = 1) -> Vortex:
            return Vortex(charge)
    """
    write(tmp_path, source)
    plugin = resolve("mask", "./my_mask.py:vortex", tmp_path)
    assert plugin.function(**plugin.bind({})).charge == 1


def test_a_module_and_a_name(install: Install) -> None:
    install(
        "trial_optics",
        "",
        masks="""
            def vortex(*, charge: int = 1): ...

            class Lens:
                def __init__(self, *, f_mm: float): ...
        """,
    )
    assert resolve("mask", "trial_optics.masks:vortex").bind({}) == {"charge": 1}
    assert resolve("mask", "trial_optics.masks:Lens").bind({"f_mm": 2}) == {"f_mm": 2.0}
    assert "trial_optics.masks defines no function 'vortx'; did you mean 'vortex'?" in refused(
        "mask", "trial_optics.masks:vortx"
    )
    assert "no module 'trial_optics.nothing' is installed" in refused("mask", "trial_optics.nothing:vortex")
    assert "./file.py:name" in refused("mask", "my_mask:vortex")
    assert "not written in Python" in refused("mask", "os:system")
    assert "scene family 'textwrap:fill'" in refused("scene", "textwrap:fill")
    for name in ("~nobody-at-all/m.py:vortex", f"{'m' * 300}.py:vortex"):
        assert "m" in refused("mask", name)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("x = 1\ny = unknown\n", ["my_mask.py:2: NameError"]),
        ("def vortex(:\n", ["my_mask.py:1: SyntaxError"]),
        ("import os\n\nimport trial_missing_package\n", ["my_mask.py:3: ModuleNotFoundError", "trial_missing_package"]),
        ("import json\njson.loads('{')\n", ["my_mask.py:2: JSONDecodeError"]),  # the user's line, not the library's
        ("raise SystemExit(3)\n", ["my_mask.py:1: SystemExit"]),
        ("def other(): ...\n", ["./my_mask.py defines no function 'vortex'"]),
        ("vortex = 3\n", ["defines no function 'vortex'"]),
        ("def vortx(): ...\n", ["did you mean 'vortx'?"]),
        ("def vortex(*, charge): ...\n", ["the parameter 'charge' has no type"]),
        ("def vortex(charge): ...\n", ["'charge'", "vortex(*, ...)"]),
        ("from os import system as vortex\n", ["not written in Python"]),
        ("def vortex(**rest): ...\n", ["'**rest'"]),
        ("def vortex(*rest: int): ...\n", ["'*rest: int'"]),
        ("def vortex(*, charge: 'Unknown'): ...\n", ["annotations", "Unknown"]),
        ("class A: ...\ndef vortex(*, charge: A): ...\n", ["its parameters cannot come from YAML"]),
        ("def vortex(*, design: str): ...\n", ["'design' is a key of its section already; rename it"]),
        ("def vortex(*, _charge: int = 1): ...\n", ["'_charge' begins with an underscore"]),
    ],
)
def test_refused_files(tmp_path: Path, source: str, words: list[str]) -> None:
    write(tmp_path, source)
    message = refused("mask", "./my_mask.py:vortex", tmp_path)
    assert message.startswith("mask design './my_mask.py:vortex': ")
    assert all(word in message for word in words), message


PARAMETERS = """
    from pathlib import Path
    from typing import Annotated, Literal

    from pydantic import Field

    def vortex(
        *,
        width_mm: Annotated[float, Field(gt=0, le=20)],
        charge: int = 1,
        kind: Literal["smooth", "stepped"] = "smooth",
        file: Path | None = None,
        files: list[Path] = [],
        pair: tuple[float, float] = (0.0, 1.0),
        reach: float = 1.0,
        label: str | None = None,
        invert: bool = False,
        copy: int = 0,
        json: int = 0,
        model_x: int = 0,
        renderer: object,
    ): ...
"""


def test_bind_gives_typed_values_with_defaults(tmp_path: Path) -> None:
    write(tmp_path, PARAMETERS)
    plugin = resolve("mask", "./my_mask.py:vortex", tmp_path)
    assert plugin.takes_renderer
    bound = plugin.bind({"width_mm": 3, "file": "a/b.png", "files": ["c.png", "/d.png"], "pair": [1, 2.5], "copy": 4})
    assert bound == {
        "width_mm": 3.0,
        "charge": 1,
        "kind": "smooth",
        "file": tmp_path / "a/b.png",
        "files": [tmp_path / "c.png", Path("/d.png")],
        "pair": (1.0, 2.5),
        "reach": 1.0,
        "label": None,
        "invert": False,
        "copy": 4,
        "json": 0,
        "model_x": 0,
    }
    assert isinstance(bound["width_mm"], float)
    assert isinstance(bound["pair"], tuple)


def test_fill_gives_plain_data_with_paths_as_written(tmp_path: Path) -> None:
    write(tmp_path, PARAMETERS)
    plugin = resolve("mask", "./my_mask.py:vortex", tmp_path)
    filled = plugin.fill({"width_mm": 3, "file": "a/b.png", "reach": math.inf})
    assert filled["file"] == "a/b.png"
    assert filled["pair"] == [0.0, 1.0]
    assert filled["reach"] == math.inf
    assert plugin.fill(filled) == filled
    assert plugin.fill({**filled, "reach": "inf"}) == filled  # as a dump has it
    assert plugin.fill({**filled, "label": "inf"})["label"] == "inf"  # text stays text


@pytest.mark.parametrize(
    ("params", "path", "words"),
    [
        ({}, ("width_mm",), ["missing"]),
        ({"width_mm": 0}, ("width_mm",), ["got 0; expected greater than 0"]),
        ({"width_mm": "3"}, ("width_mm",), ["got '3'; expected a number"]),
        ({"width_mm": math.nan}, ("width_mm",), ["got nan; expected"]),
        ({"width_mm": 3, "charge": 1.0}, ("charge",), ["got 1.0; expected a whole number"]),
        ({"width_mm": 3, "charge": True}, ("charge",), ["got true; expected a whole number"]),
        ({"width_mm": 3, "invert": 1}, ("invert",), ["got 1; expected true or false"]),
        ({"width_mm": 3, "kind": "smoth"}, ("kind",), ["expected one of smooth, stepped; did you mean 'smooth'?"]),
        ({"width_mm": 3, "pair": [1, 2, 3]}, ("pair",), ["at most 2 entries (there are 3)"]),
        ({"width_mm": 3, "pair": [1, "x"]}, ("pair", 1), ["got 'x'; expected a number"]),
        ({"width_mm": 3, "files": "a.png"}, ("files",), ["got 'a.png'; expected a list"]),
        ({"width_mm": 3, "chrge": 1}, ("chrge",), ["unknown key, got 1; expected one of design, width_mm", "'charge'"]),
        ({"width": 3}, ("width",), ["unknown key, got 3", "did you mean 'width_mm'?"]),
        ({"width_mm": 3, "renderer": "llvm"}, ("renderer",), ["unknown key, got 'llvm'"]),
        ({"width_mm": 3, "view": 1}, ("view",), ["unknown key, got 1"]),
    ],
)
def test_refused_parameters(
    tmp_path: Path, params: dict[str, object], path: tuple[str | int, ...], words: list
) -> None:
    write(tmp_path, PARAMETERS)
    plugin = resolve("mask", "./my_mask.py:vortex", tmp_path)
    for use in (plugin.bind, plugin.fill):
        with pytest.raises(ParameterError) as caught:
            use(params)
        (problem,) = caught.value.problems
        assert problem.path == path
        assert all(word in problem.text for word in words), problem.text
        assert str(caught.value) == f"mask design './my_mask.py:vortex': {problem}"


SILENT = """
class SilentError(Exception):
    def __str__(self):
        raise RuntimeError("no words")

def silent():
    raise SilentError

def leaving():
    raise SystemExit(0)
"""


@pytest.mark.parametrize(("name", "words"), [("silent", "my_mask.py:7: SilentError"), ("leaving", "SystemExit: 0")])
def test_what_a_users_code_raises_is_named(tmp_path: Path, name: str, words: str) -> None:
    write(tmp_path, SILENT)
    plugin = resolve("mask", f"./my_mask.py:{name}", tmp_path)
    with pytest.raises(InputError, match=rf"^mask './my_mask\.py:{name}': .*{words}"), plugin_errors(plugin):
        plugin.function()


def test_what_others_raise_stays_theirs_unless_it_would_end_the_process() -> None:
    plugin = resolve("mask", "pinhole")
    with pytest.raises(ZeroDivisionError), plugin_errors(plugin):
        raise ZeroDivisionError
    with pytest.raises(KeyboardInterrupt), plugin_errors(plugin):
        raise KeyboardInterrupt
    for error in (SystemExit(0), GeneratorExit()):
        with pytest.raises(InputError, match=r"^mask 'pinhole': "), plugin_errors(plugin):
            raise error
