"""Exit codes, what goes to which stream, and that nothing is left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

import api
from api import console
from stage.errors import DeviceError, InputError

LIGHTSTAGE = [sys.executable, "-m", "api.cli"]


def test_help_lists_the_verbs_of_the_design(run):
    outcome = run("--help")
    assert outcome.code == 0
    for verb in (
        "demo",
        "import",
        "plan",
        "capture",
        "simulate",
        "rig",
        "calibrate",
        "fit",
        "relight",
        "evaluate",
        "bench",
    ):
        assert f"\n  {verb} " in outcome.stdout
    assert "serve" not in outcome.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "Missing command"),
        (("nope",), "No such command 'nope'"),
        (("fit",), "Missing argument 'DATASET'"),
        (("fit", "x", "--model"), "'--model' requires an argument"),
        (("fit", "x", "--out", "y"), "Missing option '--model'"),
        (("evaluate", "x"), "Missing option '--model'"),
        (("relight", "x", "--lights", "y"), "Missing option '--out'"),
        (("plan", "--count", "many", "--out", "x"), "Invalid value for '--count'"),
        (("import", "x", "y", "z"), "unexpected extra argument"),
        (("fit", "x", "--colour", "y"), "No such option"),
    ],
)
def test_usage_errors_are_one_sentence(refused, arguments, says):
    assert says in refused(*arguments)


@pytest.mark.parametrize(
    ("raised", "code", "says"),
    [
        (InputError("a.json: field: wrong"), 2, "lightstage: a.json: field: wrong\n"),
        (InputError("a sentence\n over   lines"), 2, "lightstage: a sentence over lines\n"),
        (DeviceError("servo 1: silent"), 1, "lightstage: servo 1: silent\n"),
        (
            ValueError("odd"),
            1,
            "lightstage: failed with ValueError: odd; run it again with LIGHTSTAGE_DEBUG=1 for the traceback\n",
        ),
        (KeyboardInterrupt(), 130, "lightstage: interrupted\n"),
    ],
)
def test_every_failure_has_its_code_and_one_sentence(capsys, monkeypatch, raised, code, says):
    monkeypatch.delenv("LIGHTSTAGE_DEBUG", raising=False)

    def fail():
        raise raised

    assert console.exit_code(fail) == code
    assert capsys.readouterr() == ("", says)


def test_ctrl_c_inside_a_compiled_kernel_is_an_interruption(capsys, monkeypatch):
    monkeypatch.delenv("LIGHTSTAGE_DEBUG", raising=False)

    def fail():
        raise SystemError("kernel returned a result with an exception set") from KeyboardInterrupt()

    assert console.exit_code(fail) == 130
    assert capsys.readouterr() == ("", "lightstage: interrupted\n")


def swallow_ctrl_c() -> None:
    """What trimesh does with Ctrl-C while it is imported."""
    with contextlib.suppress(BaseException):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)


def test_ctrl_c_that_a_library_swallows_while_it_is_imported_still_interrupts(capsys):
    done = []

    def command():
        swallow_ctrl_c()
        with console.progress("step"):
            done.append("began")

    assert console.exit_code(command) == 130
    assert not done
    assert capsys.readouterr().err == "lightstage: interrupted\n"
    assert console.exit_code(lambda: None) == 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_that_is_swallowed_in_mid_step_interrupts_at_the_next_progress(capsys):
    def command():
        with console.progress("step") as progress:
            swallow_ctrl_c()
            progress(0.5)
            raise AssertionError("went on")

    assert console.exit_code(command) == 130


def test_debugging_lets_the_failure_through(monkeypatch):
    monkeypatch.setenv("LIGHTSTAGE_DEBUG", "1")

    def fail():
        raise ValueError("odd")

    with pytest.raises(ValueError, match="odd"):
        console.exit_code(fail)


def test_json_refuses_what_is_not_finite():
    with pytest.raises(ValueError, match="not JSON compliant"):
        console.as_json({"a": float("nan")})


def test_console_script_starts_without_the_heavy_libraries():
    code = (
        "import sys, api.cli; print(sorted({'numpy', 'cv2', 'numba', 'scipy', 'trimesh', 'plotly'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_plain_python_has_the_verbs_by_their_names():
    code = "import api; print([getattr(api, name).__name__ for name in api.__all__])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(api.__all__)
    assert {"capture", "check_rig", "fit", "import_", "simulate"} <= set(api.__all__)
    with pytest.raises(AttributeError, match="no attribute 'serve'"):
        api.serve  # noqa: B018


@pytest.mark.system
def test_a_true_process_keeps_its_streams_apart(ramps, tmp_path):
    command = [*LIGHTSTAGE, "evaluate", ramps, "--model", "lambert", "--json"]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    # The toy set has no normals, so a true model refuses it: the sentence is on stderr, nothing on stdout.
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "lambert cannot be fitted" in done.stderr


@pytest.mark.system
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_fit_leaves_nothing(ramps, tmp_path, number, code):
    slow = (
        "import os, sys, time\n"
        "from reconstruct.model import REGISTRY\n"
        "from tests.reconstruct import toy\n"
        "class Slow(toy.MeanImage):\n"
        "    name = 'slow'\n"
        "    @classmethod\n"
        "    def fit(cls, *arguments, **options):\n"
        "        print('fitting', flush=True)\n"
        "        while True:\n"
        "            os.read(sys.stdin.fileno(), 1)\n"
        "toy.Slow = Slow\n"
        "REGISTRY['slow'] = 'tests.reconstruct.toy:Slow'\n"
        "from api.cli import main\n"
        "main()\n"
    )
    command = [sys.executable, "-c", slow, "fit", str(ramps), "--model", "slow", "--out", str(tmp_path / "model")]
    before = set(tmp_path.iterdir())
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "fitting\n", process.stderr.read()
        assert set(tmp_path.iterdir()) != before
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == code, errors
    assert "Traceback" not in errors
    assert set(tmp_path.iterdir()) == before
