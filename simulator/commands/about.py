"""``schema`` and ``doctor``: about this tool and this machine."""

from __future__ import annotations


def schema() -> None:
    """Print the JSON schema of sim_config.yaml, for editors."""
    import json

    from simulator.config import json_schema

    print(json.dumps(json_schema(), indent=2))


def doctor() -> None:
    """Say what this machine offers, and what to install to go faster."""
    from simulator.console import print_checks
    from simulator.doctor import diagnose

    print_checks(diagnose())
