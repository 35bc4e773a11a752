"""The command line: parses, calls one function of the workflow, turns errors into one line and an exit status."""

from __future__ import annotations

import shutil
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import click

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.files import CHECKPOINT, RESULT

if TYPE_CHECKING:  # the commands take a second to import
    from aero_bayes.commands.job import RunOptions

BAD_INPUT = 2
COULD_NOT_FINISH = 3
INTERRUPTED = 130
TERMINATED = 143

Command = TypeVar("Command", bound=Callable[..., Any])
FILE = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path, file_okay=False)


class OneLineErrors(click.Group):
    """Ends with status 2 for bad input and 3 for work that could not finish, each with one clear line.

    The signal by which a batch system or a service manager ends a job (SIGTERM) is taken as Ctrl-C is."""

    def invoke(self, ctx: click.Context) -> Any:
        stopped = INTERRUPTED

        def terminate(number: int, frame: Any) -> None:
            nonlocal stopped
            stopped = TERMINATED
            signal.signal(number, signal.SIG_IGN)
            raise KeyboardInterrupt

        before = signal.getsignal(signal.SIGTERM)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, terminate)
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _OneLineWarnings()
                return super().invoke(ctx)
        except InputError as error:
            click.echo(f"error: {error.configured}", err=True)
            ctx.exit(BAD_INPUT)
        except CannotFinishError as error:
            click.echo(f"could not finish: {error}", err=True)
            ctx.exit(COULD_NOT_FINISH)
        except BrokenPipeError:
            raise  # whoever read the output has seen enough
        except OSError as error:
            click.echo(f"could not finish: {_of_the_system(error)}", err=True)
            ctx.exit(COULD_NOT_FINISH)
        except KeyboardInterrupt as stop:
            word = "interrupted" if stopped == INTERRUPTED else "terminated"
            click.echo(f"\n{word}{': ' if stop.args else ''}{' '.join(map(str, stop.args))}", err=True)
            ctx.exit(stopped)
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, before)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each command with the whole of what it does.

        Click cuts it to a line, and at the point of an abbreviation."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, " ".join((c.help or "").split())) for name, c in self.commands.items()])


class _OneLineWarnings:
    """Shows what a user is warned of as a line, once; warnings of libraries about code are for developers."""

    def __init__(self) -> None:
        self._shown: set[str] = set()

    def __call__(self, message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        line = f"note: {message}"
        if category is UserWarning and line not in self._shown:
            self._shown.add(line)
            click.echo(line, err=True)


def _of_the_system(error: OSError) -> str:
    """Return what the operating system refused, in one line: a full disk, a folder that may not be written to."""
    if isinstance(error, shutil.Error):  # one entry a file that was not copied
        return str(error.args[0][0][-1])
    if error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return f"{error}"


@click.group(cls=OneLineErrors, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="aero-bayes")
def main() -> None:
    """Fit a Modelica model to measured data, say how sure each parameter is, and find the effect it lacks."""


def run_options(command: Command) -> Command:
    """Return the options that every command which simulates a model shares."""
    for option in (
        click.option("--model", help="Modelica class or FMU file, where no configuration names one."),
        click.option("--config", type=FILE, help="TOML file with the configuration."),
        click.option(
            "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Same seed, same result."
        ),
        click.option("--workers", type=click.IntRange(min=1), help="Simulation processes.  [default: one per core]"),
        click.option("--engine", type=click.Choice(["native"]), expose_value=False, hidden=True),  # there is one
        click.option("--resume", is_flag=True, help="Continue from the checkpoint in the output folder."),
        click.option("--quiet", is_flag=True, help="Print nothing of the progress."),
        click.option("--out", type=FOLDER, required=True, help="Folder for result.json, report.html, posterior.nc."),
    ):
        command = option(command)
    return _with_state_of_folder(command)


def _with_state_of_folder(command: Command) -> Command:
    """Give a command its shared options as one; where it fails, say what its folder holds."""

    @wraps(command)
    def guarded(**given: Any) -> Any:
        from aero_bayes.commands.job import RunOptions

        shared = [field.name for field in fields(RunOptions) if field.name in given]
        options = RunOptions(**{name: given.pop(name) for name in shared})
        try:
            return command(options=options, **given)
        except (InputError, CannotFinishError) as error:
            result = options.out / RESULT
            if result.is_file():
                told = error.configured if isinstance(error, InputError) else str(error)
                raise type(error)(f"{told} ({result} is from an earlier run)") from None
            raise
        except KeyboardInterrupt:
            checkpoint = options.out / CHECKPOINT
            if checkpoint.is_file():
                raise KeyboardInterrupt(f"add --resume to the same command to continue from {checkpoint}") from None
            raise KeyboardInterrupt("there is no checkpoint yet; run the same command to start again") from None

    return cast(Command, guarded)


@main.command("fmu")
@click.option("--compiler", type=click.Choice(["auto", "omc", "embedded"]), default="auto", show_default=True)
@click.option("--model", required=True, help="Modelica class.")
@click.option("--source", "sources", type=FILE, multiple=True, help="Further .mo files to load.")
@click.option("--library", "libraries", type=FOLDER, multiple=True, help="Folder of Modelica packages to look in.")
@click.option(
    "--platforms", default="", metavar="LIST",
    help="all, or some of linux64, win64, aarch64-linux, darwin64; this machine by default.",
)  # fmt: skip
@click.option("--out", type=FILE, required=True, help="The FMU to write.")
def fmu_command(
    model: str,
    out: Path,
    compiler: Literal["auto", "omc", "embedded"],
    sources: tuple[Path, ...],
    libraries: tuple[Path, ...],
    platforms: str,
) -> None:
    """Build an FMU from Modelica source."""
    from aero_bayes.modelica.compilers import export_fmu

    out.parent.mkdir(parents=True, exist_ok=True)
    written = export_fmu(model, out, compiler=compiler, sources=sources, libraries=libraries, platforms=platforms)
    click.echo(f"wrote {written}")


@main.command("fit")
@click.option("--data", type=FILE, multiple=True, required=True, help="Recording to fit; may be given several times.")
@run_options
def fit_command(data: tuple[Path, ...], options: RunOptions) -> None:
    """Fit the parameters by a particle swarm and a bounded local search."""
    from aero_bayes.commands.commands import run_fit

    run_fit(data, options)


@main.command("posterior")
@click.option("--data", type=FILE, multiple=True, required=True, help="Recording to fit; may be given several times.")
@run_options
def posterior_command(data: tuple[Path, ...], options: RunOptions) -> None:
    """Fit, then sample the posterior by Markov chain Monte Carlo."""
    from aero_bayes.commands.commands import run_fit

    run_fit(data, replace(options, posterior=True))


@main.command("close-loop")
@click.option("--train", type=FILE, multiple=True, required=True, help="Recording to learn from.")
@click.option(
    "--test",
    type=FILE,
    multiple=True,
    help="Recording to test on: its first half validates, unless --validation is given.  "
    "[default: the last part of each training recording]",
)
@click.option("--validation", type=FILE, multiple=True, help="Recording that confirms what training finds.")
@click.option("--posterior", is_flag=True, help="Sample the posterior of the model that comes out, too.")
@run_options
def close_loop_command(
    train: tuple[Path, ...], test: tuple[Path, ...], validation: tuple[Path, ...], options: RunOptions
) -> None:
    """Find the effect that the model lacks, add it, refit, and report the error before and after."""
    from aero_bayes.commands.commands import run_close_loop

    run_close_loop(train, test, options, validation)


def _travel(context: click.Context, option: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """Read ``OUTPUT=0.5`` and its like as numbers by output."""
    limits = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            limits[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{text!r} is not OUTPUT=NUMBER, such as y=0.5") from None
    return limits


@main.command("design")
@click.option("--data", type=FILE, multiple=True, required=True, help="Recording to fit; may be given several times.")
@click.option(
    "--aim", multiple=True, metavar="PARAMETER", help="Parameter whose interval to narrow.  [default: the weak ones]"
)
@click.option("--duration", type=click.FloatRange(min=0, min_open=True), default=30.0, show_default=True, help="In s.")
@click.option("--rate", "rate_hz", type=click.FloatRange(min=0, min_open=True), help="In Hz.  [default: as recorded]")
@click.option("--amplifier", type=click.FloatRange(min=0, min_open=True), 
              help="Largest absolute input.  [default: as the package declares, else as recorded]")  # fmt: skip
@click.option("--travel", multiple=True, callback=_travel, metavar="OUTPUT=LIMIT",
              help="Largest absolute value of an output (SI).  [default: as the package declares]")  # fmt: skip
@run_options
def design_command(data: tuple[Path, ...], options: RunOptions, **asked: Any) -> None:
    """Propose the next experiment: the input that narrows weak parameters most."""
    from aero_bayes.commands.design import run_design

    run_design(data, options, **asked)


@main.command("all")
@click.option("--data", type=FILE, multiple=True, required=True, help="Recording to learn from.")
@click.option("--test", type=FILE, multiple=True, help="Recording to test on.")
@run_options
def all_command(data: tuple[Path, ...], test: tuple[Path, ...], options: RunOptions) -> None:
    """Run what plain `make` runs: FMU, fit, closed loop, posterior, one page."""
    from aero_bayes.commands.commands import run_all

    run_all(data, test, options)


@main.command("init")
@click.argument("source", type=FILE, metavar="RIG.MO")
@click.argument("data", type=FILE, metavar="RUN.CSV")
@click.option("--model", help="Modelica class.  [default: the one that no other in the file uses]")
@click.option("--library", "libraries", type=FOLDER, multiple=True, help="Folder of Modelica packages to look in.")
@click.option("--out", type=FILE, default=Path("rig.toml"), show_default=True, help="The file to write.")
def init_command(source: Path, data: Path, model: str | None, libraries: tuple[Path, ...], out: Path) -> None:
    """Write the configuration for a model and a recording: columns matched by name, every parameter listed."""
    from aero_bayes.commands.init import run_init

    run_init(source, data, out, model=model, libraries=libraries)


@main.command("ports")
@click.option("--model", help="Modelica class or FMU file, where no configuration names one.")
@click.option("--config", type=FILE, help="TOML file with the sources, and for --data columns and free parameters.")
@click.option("--data", type=FILE, multiple=True, help="Recording; shows which ports are visible in it.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def ports_command(model: str | None, config: Path | None, data: tuple[Path, ...], as_json: bool) -> None:
    """List where an effect may be missing in a model, and the laws that fit there."""
    from aero_bayes.commands.ports import run_ports

    run_ports(model, config, data, as_json=as_json)


@main.command("report")
@click.argument("directory", type=FOLDER)
def report_command(directory: Path) -> None:
    """Draw the page of a finished run again."""
    from aero_bayes.report.page import write_run_page

    click.echo(f"wrote {write_run_page(directory)}")


@main.command("compare")
@click.argument("directories", type=FOLDER, nargs=-1, required=True, metavar="DIR DIR [DIR ...]")
@click.option("--out", type=FILE, default=Path(), help="Folder for compare.html, or the page.  [default: this folder]")
def compare_command(directories: tuple[Path, ...], out: Path) -> None:
    """Compare finished runs in one table: parameters, errors, different settings."""
    from aero_bayes.report.compare import write_comparison

    page = out if out.suffix == ".html" else out / "compare.html"
    page.parent.mkdir(parents=True, exist_ok=True)
    click.echo(f"wrote {write_comparison(directories, page)}")


@main.command("check")
@click.argument("recordings", type=FILE, nargs=-1)
@click.option("--data", type=FILE, multiple=True, help="Recording, as fit takes it; may be given several times.")
@click.option("--model", help="Modelica class or FMU file, where no configuration names one.")
@click.option("--config", type=FILE, help="TOML file with the model and the mapping of columns.")
def check_command(recordings: tuple[Path, ...], data: tuple[Path, ...], model: str | None, config: Path | None) -> None:
    """Read, check and summarise recordings."""
    from aero_bayes.commands.commands import run_check

    if not (given := (*recordings, *data)):
        raise click.UsageError("name a recording, as by --data FILE")
    run_check(given, config, model)


@main.command("fleet")
@click.option("--config", type=FILE, required=True, help="TOML file with [fleet] and the rigs.")
@click.option("--out", type=FOLDER, required=True, help="Folder for rigs/, rigs.jsonl, fleet.json, report.html.")
@click.option("--dask", metavar="ADDRESS", help="Dask scheduler, its file, or local.  [default: no Dask]")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Same seed, same result.")
@click.option("--workers", type=click.IntRange(min=1), help="Rigs at a time on this machine.  [default: one per core]")
@click.option("--quiet", is_flag=True, help="No progress bar.")
def fleet_command(config: Path, out: Path, dask: str | None, seed: int, workers: int | None, quiet: bool) -> None:
    """Fit many rigs of one model and compare them. Rigs that were fitted before are not fitted again."""
    from aero_bayes.commands.fleet import fleet, read_fleet
    from aero_bayes.commands.fleet_runner import open_client
    from aero_bayes.files import one_run_at_a_time
    from aero_bayes.progress import ProgressBar

    total, done = len(read_fleet(config).rigs), 0
    with one_run_at_a_time(out), open_client(dask, workers) as client, ProgressBar(quiet) as bar:

        def progress(count: int) -> None:
            nonlocal done
            done += count
            bar("rigs", done / total, f"{done} of {total}")

        progress(0)
        try:
            result = fleet(config, out, seed=seed, client=client, workers=workers, progress=progress)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"run the same command again to continue from {out / 'rigs.jsonl'}") from None
    click.echo(result.verdict.text.replace("`", "") if result.verdict else "")
    click.echo(f"wrote {out / 'fleet.json'} and {out / 'report.html'}")


if __name__ == "__main__":
    sys.exit(main())
