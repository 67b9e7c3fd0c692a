"""``init``, ``generate``, ``status``, ``merge``, ``verify``: data sets from a configuration."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.commands.shared import ConfigPath, Overrides
from simulator.console import Bar, JsonLog
from simulator.errors import InputError
from simulator.io.store import Place
from simulator.text import described

if TYPE_CHECKING:
    from simulator.dataset.job import GenerateResult

MadeFrom = Annotated[
    Path | None,
    typer.Option("--config", help="the YAML file that it was made from, where that names files or code of its own"),
]
TrustCode = Annotated[bool, typer.Option("--trust-code", help="run the code that the data set names")]
_USE = re.compile(r"# [A-Z][^:]*: +flatlight ")  # in the head of a preset: what it is for


def init(
    path: Annotated[
        Path | None, typer.Argument(help="file to write; sim_config.yaml, or PRESET.yaml", show_default=False)
    ] = None,
    preset: Annotated[
        str | None, typer.Option("--preset", metavar="NAME", help="another beginning; --preset help lists them")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="overwrite an existing file")] = False,
) -> None:
    """Write a commented sim_config.yaml that runs as it is."""
    from simulator.io.files import write_atomic
    from simulator.presets import DEFAULT, preset_names, preset_text

    if preset == "help":
        for name in preset_names(others=True):
            print(f"{name:<25} {preset_text(name).splitlines()[0].removeprefix('# ')}")
        return
    text = preset_text(preset or DEFAULT)
    path = path or Path("sim_config.yaml" if preset is None else f"{preset}.yaml")
    if path.exists() and not force:
        raise InputError(path, "exists already; choose another name, or --force to overwrite it")
    write_atomic(path, text.encode())
    head = [line.removeprefix("# ") for line in text.splitlines() if _USE.match(line)]
    uses = [re.sub(r"\bFILE\b|sim_config\.yaml", lambda _: str(path), line) for line in head]
    print("\n".join([f"wrote {path}", *uses]))


def generate(
    config: ConfigPath,
    set_: Overrides = None,
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="leave out files and samples that cannot be used, and list them")
    ] = False,
    accept_exposure: Annotated[
        bool,
        typer.Option("--accept-exposure", help="go on where no value would carry signal: saturated, black or noise"),
    ] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="check every byte first, and make anew exactly what is damaged")
    ] = False,
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="I/N", help="make part I of N, from 0; the others may run at the same time"),
    ] = None,
    ignore_space: Annotated[
        bool,
        typer.Option("--ignore-space", help="go on where the disk has no room for all that the first samples forecast"),
    ] = False,
    log_json: Annotated[
        bool, typer.Option("--log-json", help="tell progress, messages and the result on stdout, a line of JSON each")
    ] = False,
    estimate: Annotated[
        bool, typer.Option("--estimate", help="make three samples, throw them away, and say what all will cost")
    ] = False,
    price: Annotated[
        float | None, typer.Option("--price", min=0, help="with --estimate: of a CPU-hour, in any currency")
    ] = None,
) -> None:
    """Make a data set, or finish one that was begun."""
    from simulator.dataset.job import generate as run
    from simulator.dataset.shards import Shard

    if price is not None and not estimate:
        raise InputError("--price", f"got {price:g} without --estimate, which alone uses it; add that, or leave it out")
    if estimate:
        beside = {"--shard": shard, "--repair": repair, "--log-json": log_json, "--skip-bad": skip_bad}
        beside |= {"--accept-exposure": accept_exposure, "--ignore-space": ignore_space}
        for option in (option for option, value in beside.items() if value):
            raise InputError(option, "got it beside --estimate, which makes no data set; leave one of them out")
        _estimate(config, set_ or [], price)
        return
    with JsonLog() if log_json else Bar() as shown:
        try:
            result = run(
                config,
                set_ or [],
                shard=None if shard is None else Shard.parsed(shard),
                skip_bad=skip_bad,
                accept_exposure=accept_exposure,
                repair=repair,
                ignore_space=ignore_space,
                progress=shown.update,
                say=shown.say,
                watch=shown.watch,
                finish=_draw,
            )
        except BaseException as error:
            if isinstance(shown, JsonLog):
                event = "error" if isinstance(error, Exception) else "stopped"
                shown.tell(event, text=str(error) if isinstance(error, InputError) else described(error))
            raise
        if isinstance(shown, JsonLog):
            shown.tell("end", **vars(result))
    if not log_json:
        _tell(result)  # once the bar has ended, which draws stdout's lines as its own
    if result.failed or (shard is None and not result.made + result.kept):
        raise typer.Exit(1)


def _estimate(config: Path, overrides: list[str], price: float | None) -> None:
    from simulator.dataset.estimate import estimate as run

    with Bar() as bar:
        found = run(config, overrides, price=price, progress=bar.update, say=bar.say)
    print(found)


def _tell(result: GenerateResult) -> None:
    """Print what a run did: on stdout where to look, on stderr what is missing."""
    from simulator.dataset.checksums import REPORT
    from simulator.dataset.manifest import FAILED, SKIPPED
    from simulator.dataset.problems import PROBLEMS, shortened

    kept = f", {result.kept} were there before" if result.kept else ""
    print(f"{result.made} samples made in {result.seconds:.0f} s{kept}: {result.path}")
    if result.missing:
        print(f"left to other shards: {result.missing}; flatlight status {result.path} says more")
    elif not result.sealed:
        print("all samples are there; the same command without --shard, once no shard is at work, seals the data set")
    elif result.made + result.kept:
        print(f"look at {result.path / REPORT}")
    if result.problems:
        print(f"of the source was left out what {result.path / PROBLEMS} lists: {len(result.problems)} in all")
    if result.skipped:
        listed = f"{result.path / SKIPPED} says which and why"
        print(f"{len(result.skipped)} samples were left out: {listed}\n{shortened(result.skipped)}", file=sys.stderr)
    if result.failed:
        listed = f"{result.path / FAILED} has the tracebacks"
        print(shortened([f"failed: {line}" for line in result.failed], indent=""), file=sys.stderr)
        print(
            f"{len(result.failed)} samples failed, {listed}; run the same command again to retry them", file=sys.stderr
        )


def status(
    path: Annotated[str, typer.Argument(help="folder of the data set, or its place in an object store")],
    shards: Annotated[
        int | None, typer.Option("--shards", metavar="N", help="name the shards of N that have samples left")
    ] = None,
) -> None:
    """Say how much of a data set is done, what failed and what is missing; while it is being made, from any machine."""
    from simulator.dataset.status import status as run

    print(run(path, shards))


def regenerate(
    path: Annotated[str, typer.Argument(help="folder of the data set, or its place in an object store")],
    samples: Annotated[list[str], typer.Argument(metavar="SAMPLE...", help="such as s00000012 or train/s00000012")],
    config: MadeFrom = None,
    trust_code: TrustCode = False,
) -> None:
    """Make samples again and compare them with the stored ones, which stay as they are."""
    from simulator.dataset.regeneration import named_sample

    _make_again(path, [named_sample(path, name) for name in samples], config, trust_code)


def _make_again(path: str, keys: list[tuple[str, str]], config: Path | None, trust_code: bool) -> None:
    from simulator.dataset.regeneration import regenerate as run

    with Bar() as bar:
        found = run(path, keys, config=config, trust_code=trust_code, progress=bar.update)
    for line in found.elsewhere:
        print(f"not as where it was made: {line}")
    for sample in found.samples:
        print(sample)
    if found.faults:
        raise typer.Exit(2)


def merge(
    output: Annotated[str, typer.Argument(help="the data set that the samples come together in; may be a new folder")],
    parts: Annotated[list[str], typer.Argument(help="folders of data sets of the same configuration")],
) -> None:
    """Make one data set of parts that were made apart."""
    from simulator.dataset.merging import merge as run

    with Bar() as bar:
        result = run(
            output,
            parts,
            progress=lambda done, total: bar.update("samples looked at", done, total),
            finish=_draw,
        )
    for line in result.problems:
        print(f"not taken: {line}", file=sys.stderr)
    print(f"{result.taken} samples taken, {result.there} were there before, {result.missing} missing: {result.path}")
    if result.problems:
        raise typer.Exit(1)


def _draw(root: Place) -> None:
    from simulator.dataset.checksums import CONTACT_SHEET
    from simulator.plots.contact_sheet import contact_sheet
    from simulator.plots.report.page import write_report

    contact_sheet(root, root / CONTACT_SHEET)
    write_report(root)


def verify(
    path: Annotated[str, typer.Argument(help="folder of the data set, or its place in an object store")],
    workers: Annotated[int, typer.Option(min=1, help="processes that check samples")] = 1,
    seal: Annotated[
        bool, typer.Option("--seal", help="write checksums.json where it is all that is missing, as in older data sets")
    ] = False,
    deep: Annotated[
        int, typer.Option("--deep", metavar="COUNT", min=0, help="make so many random samples again, and compare them")
    ] = 0,
    config: MadeFrom = None,
    trust_code: TrustCode = False,
) -> None:
    """Re-hash and re-read every file of a data set; of its code only --deep runs any, and only what you trust."""
    from simulator.dataset.verification import verify as run

    with Bar() as bar:
        report = run(
            path, workers=workers, seal=seal, progress=lambda done, total: bar.update("samples checked", done, total)
        )
    print(report)
    if not report.ok:
        raise typer.Exit(2)
    if deep:
        from simulator.dataset.regeneration import some_samples

        _make_again(path, some_samples(path, deep), config, trust_code)
