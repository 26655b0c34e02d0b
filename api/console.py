"""What a command says: results on stdout, progress and errors on stderr, one sentence per error."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from typer.core import TyperGroup
from typer.exceptions import Abort, TyperException

from stage.errors import DeviceError, EndedEarlyError, InputError
from stage.interruption import interrupted

Progress = Callable[[float], None]

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130
DEBUG = "LIGHTSTAGE_DEBUG"
QUIET_START_S = 30.0
"""Where stderr is no terminal, a step says nothing for so long: one that refuses its input says so alone, even where
kernels are compiled first."""

QUIET_SPELL_S = 5.0
"""Time between two lines on progress after that."""


class _CtrlC:
    """Ctrl-C, remembered: some libraries swallow it while they are imported, trimesh for one."""

    pressed = False

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """Raise `KeyboardInterrupt` as ever, and once more in `check`."""
        self.pressed = False
        in_main = threading.current_thread() is threading.main_thread()
        if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield  # not ours to handle
            return
        signal.signal(signal.SIGINT, self._press)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def check(self) -> None:
        """Raise `KeyboardInterrupt` where it has been pressed and the command runs on."""
        if self.pressed:
            raise KeyboardInterrupt

    def _press(self, signum: int, frame: FrameType | None) -> None:
        self.pressed = True
        raise KeyboardInterrupt


_ctrl_c = _CtrlC()


class OneSentence(TyperGroup):
    """The command group whose every failure is an exit code and one sentence on stderr, never a traceback."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Parse, run and exit."""
        kwargs["standalone_mode"] = False
        sys.exit(exit_code(lambda: super(OneSentence, self).main(*args, **kwargs)))


def exit_code(run: Callable[[], object]) -> int:
    """Run and return the process's exit code; with ``LIGHTSTAGE_DEBUG=1`` failures pass through as they are."""
    try:
        with _ctrl_c.heeded():
            returned = run()
    except KeyboardInterrupt:
        returned = INTERRUPTED
    except Exception as error:
        if debugging():
            raise
        if not interrupted(error):
            return _told(error)
        returned = INTERRUPTED
    if returned == INTERRUPTED:
        say("interrupted")
    return returned if isinstance(returned, int) else 0


def debugging() -> bool:
    """Whether a person asked for tracebacks and warnings."""
    return os.environ.get(DEBUG, "") not in ("", "0")


def _told(error: Exception) -> int:
    if isinstance(error, TyperException):
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "lightstage"
        say(f"{error.format_message().rstrip('.')}; '{command} --help' lists what it takes")
        return error.exit_code
    if isinstance(error, InputError):
        say(str(error))
        return BAD_INPUT
    if isinstance(error, (DeviceError, EndedEarlyError)):
        say(str(error))
        return FAILED
    if isinstance(error, Abort):
        say("aborted")
        return FAILED
    if isinstance(error, BrokenPipeError):
        # Whoever read stdout has gone; without this the interpreter complains once more as it closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    say(f"failed with {type(error).__name__}: {error}; run it again with {DEBUG}=1 for the traceback")
    return FAILED


def say(sentence: str) -> None:
    """Print a sentence for people to stderr, as long as anybody reads it."""
    with suppress(OSError, ValueError):
        print("lightstage: " + " ".join(sentence.split()), file=sys.stderr)


def write_json(value: Any) -> None:
    """Print one JSON value to stdout; see `as_json`."""
    print(as_json(value))


def as_json(value: Any) -> str:
    """Text of a JSON value; numpy numbers and arrays and paths are understood, what is not finite is a `ValueError`."""
    return json.dumps(value, indent=1, allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    """JSON for numpy scalars and arrays, paths and the like."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def write_result(result: dict[str, Any], as_json: bool) -> None:
    """Print what a verb found: one JSON value for machines, or for people what is not empty."""
    if as_json:
        write_json(result)
    else:
        write_facts({key: value for key, value in result.items() if value not in ([], {}, None)})


def write_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """Print a table for people to stdout; the first column is text, the others are figures."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(file=sys.stdout)
    # A narrow window wraps a line; it must not cost a figure.
    console.width = max(console.width, console.measure(table, options=console.options.update(width=1000)).maximum)
    console.print(table)


def write_facts(facts: dict[str, Any]) -> None:
    """Print labelled values for people to stdout, one a line; parts of a value stand indented below its label."""
    width = max((len(label) for label in facts), default=0)
    for label, value in facts.items():
        if isinstance(value, dict):
            print(label)
            write_facts({f"  {name}": figure for name, figure in value.items()})
        elif isinstance(value, list) and value and all(isinstance(item, str) and " " in item for item in value):
            print(label, *(f"  {sentence}" for sentence in value), sep="\n")
        elif isinstance(value, float):
            print(f"{label:<{width}}  {value:.6g}")
        else:
            print(f"{label:<{width}}  {value}")


@contextmanager
def progress(label: str) -> Iterator[Progress]:
    """Show how far a step is: a bar that vanishes on a terminal, else a line now and then and one at the end.

    A step that fails early prints no line, so that its error stays alone on stderr. A Ctrl-C that somebody swallowed is
    raised again at the beginning of the step and whenever it tells how far it is.
    """
    _ctrl_c.check()
    if not sys.stderr.isatty():
        yield from _lines(label)
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(file=sys.stderr), transient=True) as bars:
        task = bars.add_task(label, total=1.0)

        def show(share: float) -> None:
            _ctrl_c.check()
            bars.update(task, completed=share)

        yield show


def _lines(label: str) -> Iterator[Progress]:
    begin = time.monotonic()
    last = begin + QUIET_START_S - QUIET_SPELL_S

    def show(share: float) -> None:
        nonlocal last
        _ctrl_c.check()
        if time.monotonic() - last >= QUIET_SPELL_S:
            last = time.monotonic()
            print(f"{label}: {100 * share:.0f} %", file=sys.stderr, flush=True)

    yield show
    print(f"{label}: done in {time.monotonic() - begin:.1f} s", file=sys.stderr, flush=True)
