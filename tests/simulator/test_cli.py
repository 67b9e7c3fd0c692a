"""The command itself: its start, its help, its exit codes, and commands that other packages add."""

import json
import sys

import jsonschema
import pytest
import yaml

from simulator import cli
from simulator.config import default_config_text
from simulator.entry_points import commands
from simulator.errors import InputError


class TestStart:
    def test_help_is_quick(self, command) -> None:
        heavy = ["numpy", "pydantic", "mitsuba", "drjit", "torch", "colour", "matplotlib", "scipy", "OpenEXR", "yaml"]
        tell = f"atexit.register(lambda: print([name for name in {heavy} if name in sys.modules]))"
        done = command("--help", before=f"import atexit, sys\n{tell}")
        assert done.returncode == 0
        names = {"init", "generate", "psf", "compare", "masks", "export-mask", "scenes", "verify", "schema", "doctor"}
        assert names <= set(done.stdout.split())
        assert done.stdout.splitlines()[-1] == "[]"

    def test_version(self, flatlight) -> None:
        from importlib.metadata import version

        assert flatlight("--version") == (0, f"flatlight {version('flatlight')}\n", "")

    @pytest.mark.parametrize("arguments", [["genrate"], ["generate"], ["generate", "a.yaml", "--sed", "3"], []])
    def test_usage_errors(self, flatlight, arguments: list[str]) -> None:
        code, out, err = flatlight(*arguments)
        assert code == 2
        assert "Usage: " in out + err
        assert "Traceback" not in out + err

    def test_a_command_of_another_package(self, flatlight, install) -> None:
        code = "def greet(name: str):\n    '''Say hello.'''\n    print('hello', name)\n"
        install("others", "[flatlight.commands]\ngreet = others:greet\n", __init__=code)
        assert "Say hello." in flatlight("--help")[1]
        assert flatlight("greet", "Ada")[:2] == (0, "hello Ada\n")
        install("rivals", "[flatlight.commands]\ngreet = rivals:greet\n")
        with pytest.raises(InputError, match=r"'greet' .*(others|rivals):greet .*(others|rivals):greet"):
            commands()

    def test_a_command_that_does_not_import_stops_no_other(self, flatlight, install) -> None:
        install("broken", "[flatlight.commands]\ngreet = broken_module:greet\n")
        code, out, err = flatlight("masks", "pinhole")
        assert code == 0
        assert "pinhole" in out
        assert "'greet' (broken_module:greet)" in err
        assert "ModuleNotFoundError" in err
        assert "Traceback" not in err

    def test_a_fault_of_ours_says_so(self, flatlight, monkeypatch: pytest.MonkeyPatch) -> None:
        def broken() -> str:
            raise ZeroDivisionError("by surprise")

        monkeypatch.setattr("simulator.config.json_schema", broken)
        code, out, err = flatlight("schema")
        assert (code, out) == (1, "")
        assert "internal error: ZeroDivisionError: by surprise" in err
        assert "FLATLIGHT_TRACEBACK" in err
        assert "Traceback" not in err

    @pytest.mark.parametrize(
        "words",
        [["verify"], ["generate"], ["init"], ["import", "--check"], ["render", "sim_config.yaml", "--output"]],
        ids=" ".join,
    )
    def test_a_name_that_no_file_can_have(self, flatlight, words: list[str]) -> None:
        code, _, err = flatlight(*words, f"{'x' * 300}.png")
        assert code == 2
        assert err.startswith(("error: 'xxx", "error: xxx", "error: --check: ", "error: --output: "))
        assert len(err.splitlines()) == 1

    def test_the_traceback_on_request(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("simulator.config.json_schema", lambda: 1 / 0)
        monkeypatch.setenv("FLATLIGHT_TRACEBACK", "1")
        monkeypatch.setattr(sys, "argv", ["flatlight", "schema"])
        with pytest.raises(ZeroDivisionError):
            cli.main()


def test_schema_describes_the_shipped_configuration(flatlight) -> None:
    schema = json.loads(flatlight("schema")[1])
    validator = jsonschema.validators.validator_for(schema)
    validator.check_schema(schema)
    config = yaml.safe_load(default_config_text())
    validator(schema).validate(config)
    config["camera"]["sensr"] = {}
    assert not validator(schema).is_valid(config)
