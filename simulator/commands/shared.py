"""What the commands share: options and the files that they write."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from simulator.errors import InputError

ConfigPath = Annotated[Path, typer.Argument(help="configuration; `flatlight init` writes one", show_default=False)]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override one setting; dots separate nested keys")
]


def check_output_file(option: str, path: Path, suffixes: tuple[str, ...]) -> None:
    """Refuse a file that could not be written, or whose name says that it is of another kind.

    ``suffixes``: what its name may end in, in lower case.

    Raises:
        InputError: an address, another suffix, a folder of that name, or no folder to write into.
    """
    _refuse_address(option, path)
    if path.suffix.lower() not in suffixes:
        raise InputError(option, f"got {path.name!r}, expected a name that ends in {' or '.join(suffixes)}")
    if path.is_dir():
        raise InputError(option, f"{path} exists already and is a folder; choose another name")
    if not path.absolute().parent.is_dir():
        raise InputError(option, f"the folder {path.parent} does not exist; make it first, or choose another")


def check_output_folder(option: str, folder: Path) -> None:
    """Refuse a folder that could not be made; missing ones above it are made with it.

    Raises:
        InputError: an address, or a part of the path is a file.
    """
    _refuse_address(option, folder)
    above = next(place for place in folder.absolute().parents if place.exists())
    if not above.is_dir():
        raise InputError(option, f"{folder} cannot be made, {above} is a file; choose another folder")


def _refuse_address(option: str, path: Path) -> None:
    if re.match(r"[a-z][a-z0-9]+:/", str(path)):
        raise InputError(option, f"got the address {str(path)!r}, expected a place on this machine")


def check_distinct(places: Mapping[str, Path | None]) -> None:
    """Refuse two outputs at one place.

    Raises:
        InputError: naming both options.
    """
    taken: dict[Path, str] = {}
    for option, path in places.items():
        if path is None:
            continue
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise InputError(option, f"got {path}, which {other} writes already; choose another name")
