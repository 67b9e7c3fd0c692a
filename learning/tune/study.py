"""The file of a tuning: every trial as soon as it is finished, the result of each method and noise level."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.checkpoint import DENOISER
from learning.tune.search import Parameters
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.io.json import canonical_json, plain, readable_json
from simulator.validation import renamed

FORMAT, VERSION = "flatlight tuned", 1


@dataclass(frozen=True)
class Tuned:
    """Chosen parameters by method and noise level: all of a file, see `Study`."""

    path: Path
    content: dict[str, Any]

    def levels_db(self, method: str) -> list[float]:
        """Return the tuned noise levels of a method, increasing; an InputError says that it was not tuned."""
        levels = sorted(result["noise_db"] for result in self.content["results"] if result["method"] == method)
        if not levels:
            known = sorted({result["method"] for result in self.content["results"]})
            wanted = f"one that was tuned ({', '.join(known) or 'none'})"
            raise InputError(self.path, f"got the method {method!r}, expected {wanted}; run `flatlight tune` with it")
        return levels

    def parameters(self, method: str, noise_db: float) -> tuple[Parameters, float]:
        """Return the parameters of a method at a noise level, and the tuned level that they are of: the nearest.

        A denoiser's file, which is recorded as it lies from this file's folder, is given as an absolute path.
        """
        nearest = min(self.levels_db(method), key=lambda level: abs(level - noise_db))
        found = (r for r in self.content["results"] if r["method"] == method and r["noise_db"] == nearest)
        parameters = dict(next(found)["parameters"])
        if parameters.get("denoiser", DENOISER) != DENOISER:
            parameters["denoiser"] = str(self.path.resolve().parent / parameters["denoiser"])
        return parameters, nearest


def load_tuned(path: Path | str) -> Tuned:
    """Read what `flatlight tune` wrote, finished or not: levels that are not finished are left out.

    Raises:
        InputError: no such file, a damaged one, or another kind of file.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}; `flatlight tune` writes such a file"
        raise InputError(path, reason) from error
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"damaged, or not written by `flatlight tune` ({error}); tune again") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(path, f"not a result of `flatlight tune`: its format is not {FORMAT!r}")
    if content.get("version") != VERSION:
        raise InputError(path, f"got version {content.get('version')!r}, expected {VERSION}; tune again")
    wanted: tuple[tuple[str, type], ...] = (("identity", dict), ("trials", list), ("results", list))
    for name, kind in wanted:
        if not isinstance(content.get(name), kind):
            raise InputError(path, f"damaged: {name} is missing or of another kind; restore it, or tune again")
    for entry in [*content["trials"], *content["results"]]:
        if not isinstance(entry, dict) or not {"method", "noise_db", "parameters", "score"} <= entry.keys():
            raise InputError(path, f"damaged: {str(entry)[:60]} lacks a method, level, parameters or score")
    return Tuned(path, renamed(content))


class Study:
    """Trials and results, written to the file after each: a run that dies loses the trial that it was at, no more.

    The file has ``identity`` (all that decides the score of some parameters: data, camera, objective, version), ``about``
    (words and numbers for readers), ``trials`` and ``results``. Search space, methods and levels may change between runs:
    what was tried already is not tried again.
    """

    def __init__(self, path: Path, identity: dict[str, Any], about: dict[str, Any]) -> None:
        """Open the file, or begin one."""
        self.path = path
        self._content: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "identity": plain(identity, "identity"),
            "about": plain(about, "about"),
            "trials": [],
            "results": [],
        }
        if path.exists():
            old = load_tuned(path).content
            self._check(old["identity"])
            identity = old["identity"] | self._content["identity"]
            self._content |= {"identity": identity, "trials": old["trials"], "results": old["results"]}
        self._scores = {self._key(t["method"], t["noise_db"], t["parameters"]): t for t in self._content["trials"]}

    @property
    def results(self) -> list[dict[str, Any]]:
        """What was found, by method and level."""
        return self._content["results"]

    @property
    def trials(self) -> list[dict[str, Any]]:
        """All trials, in the order in which they were made."""
        return self._content["trials"]

    def trial(self, method: str, noise_db: float, parameters: Parameters) -> dict[str, Any] | None:
        """Return the trial of these parameters, or None."""
        return self._scores.get(self._key(method, noise_db, parameters))

    def add_trial(self, trial: dict[str, Any]) -> None:
        """Keep a trial: ``method``, ``noise_db``, ``parameters``, ``score`` and what else is known of it."""
        self._content["trials"].append(plain(trial, "trial"))
        self._scores[self._key(trial["method"], trial["noise_db"], trial["parameters"])] = self._content["trials"][-1]
        self._save()

    def add_result(self, result: dict[str, Any]) -> None:
        """Keep the result of a method at a level, in the place of an older one."""
        here = (result["method"], result["noise_db"])
        others = [r for r in self.results if (r["method"], r["noise_db"]) != here]
        together = [*others, plain(result, "result")]
        self._content["results"] = sorted(together, key=lambda r: (r["method"], r["noise_db"]))
        self._save()

    def _save(self) -> None:
        write_atomic(self.path, readable_json(self._content))

    def _check(self, old: dict[str, Any]) -> None:
        new = self._content["identity"]
        for name in sorted(new.keys() & old.keys()):  # what only one needs is of methods that only one has
            if new[name] != old[name]:
                was, now = (str(content[name])[:60] for content in (old, new))
                differs = f"{name} was {was}, is now {now}"
                cure = "choose another output, or delete it"
                raise InputError(self.path, f"holds trials of other data or settings: {differs}; {cure}")

    @staticmethod
    def _key(method: str, noise_db: float, parameters: Parameters) -> bytes:
        return canonical_json([method, float(noise_db), parameters])
