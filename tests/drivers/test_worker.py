"""What becomes of a worker process that hangs, dies, raises, prints, or loses its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.worker import Worker
from stage.errors import DeviceError, InputError

pytestmark = pytest.mark.system
START_S = 20.0
PARENT = """
import sys, time
from drivers.worker import Worker
worker = Worker("tests.drivers.test_worker:Sdk", {"greeting": "hello"}, "parrot on perch 1")
worker.start(20.0)
print(worker.call("pid", timeout_s=5.0), flush=True)
worker.call("hang", timeout_s=60.0)
"""


class Sdk:
    """Stands in for a vendor's library."""

    def __init__(self, greeting: str) -> None:
        if greeting == "refuse":
            raise DeviceError("parrot: it refuses to talk; feed it")
        self._greeting = greeting

    def greet(self, whom: str) -> str:
        return f"{self._greeting} {whom}"

    def pid(self) -> int:
        return os.getpid()

    def file(self, size: int) -> bytes:
        return b"\xa5" * size

    def hang(self) -> None:
        time.sleep(600)

    def stop(self) -> None:
        os.kill(os.getpid(), signal.SIGSTOP)

    def crash(self) -> None:
        print("first line\nparrot.c:12: assertion 'alive' failed", file=sys.stderr, flush=True)
        os.abort()

    def chatter(self, size: int) -> None:
        os.write(1, b"squawk\n" * (size // 7))

    def fail(self, kind: str) -> None:
        raise {"device": DeviceError, "input": InputError, "other": KeyError}[kind]("perch 1: it fell; pick it up")

    def breed(self) -> int:
        return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]).pid


def gone(pid: int, within_s: float = 5.0) -> bool:
    """Whether the process is gone, or only waits for init to take note of that."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def worker() -> Iterator[Worker]:
    before, threads = sorted(os.listdir("/proc/self/fd")), threading.active_count()  # noqa: PTH208 - links that come and go
    made = Worker("tests.drivers.test_worker:Sdk", {"greeting": "hello"}, "parrot on perch 1")
    yield made
    made.close()
    assert not made.alive
    assert len(os.listdir("/proc/self/fd")) == len(before)  # noqa: PTH208
    assert threading.active_count() == threads


def test_calls_run_in_another_process(worker: Worker) -> None:
    with pytest.raises(DeviceError, match=r"parrot on perch 1: greet needs its worker process, .* open it first"):
        worker.call("greet", "you", timeout_s=5.0)
    worker.start(START_S)
    worker.start(START_S)
    assert worker.alive
    assert worker.call("greet", "you", timeout_s=5.0) == "hello you"
    pid = worker.call("pid", timeout_s=5.0)
    assert pid == worker.pid != os.getpid()
    worker.close()
    worker.close()
    assert worker.pid is None
    assert gone(pid, 0.1)


def test_what_hangs_is_killed_at_its_deadline_and_started_anew(worker: Worker) -> None:
    worker.start(START_S)
    pid = worker.call("pid", timeout_s=5.0)
    start = time.monotonic()
    with pytest.raises(DeviceError, match=r"parrot on perch 1: hang was not done within 0\.3 s.*killed; try again"):
        worker.call("hang", timeout_s=0.3)
    assert 0.3 <= time.monotonic() - start < 1.5
    assert gone(pid, 0.1)
    assert not worker.alive
    worker.start(START_S)
    assert worker.call("pid", timeout_s=5.0) != pid


def test_a_process_that_was_stopped_is_killed_too(worker: Worker) -> None:
    worker.start(START_S)
    with pytest.raises(DeviceError, match="stop was not done within"):
        worker.call("stop", timeout_s=0.3)
    assert not worker.alive


def test_a_crash_is_told_with_the_last_words(worker: Worker) -> None:
    worker.start(START_S)
    with pytest.raises(DeviceError) as failure:
        worker.call("crash", timeout_s=5.0)
    assert str(failure.value) == (
        "parrot on perch 1: its worker process died during crash (signal SIGABRT, its last words: first line / "
        "parrot.c:12: assertion 'alive' failed); try again"
    )
    worker.start(START_S)
    assert worker.call("greet", "again", timeout_s=5.0) == "hello again"


@pytest.mark.parametrize(
    ("kind", "error", "sentence"),
    [
        ("device", DeviceError, "^perch 1: it fell; pick it up$"),
        ("input", InputError, "^perch 1: it fell; pick it up$"),
        ("other", DeviceError, "^parrot on perch 1: fail failed: KeyError: .*; check the device, then try again$"),
    ],
)
def test_what_is_raised_arrives_as_a_sentence_and_the_process_goes_on(
    worker: Worker, kind: str, error: type[Exception], sentence: str
) -> None:
    worker.start(START_S)
    with pytest.raises(error, match=sentence):
        worker.call("fail", kind, timeout_s=5.0)
    assert worker.call("greet", "you", timeout_s=5.0) == "hello you"


@pytest.mark.parametrize(
    ("target", "arguments", "sentence"),
    [
        ("tests.drivers.test_worker:Sdk", {"greeting": "refuse"}, "parrot: it refuses to talk; feed it"),
        ("tests.drivers.test_worker:Sdk", {}, "parrot on perch 1: starting its SDK failed: TypeError"),
        ("no.such:Thing", {}, "parrot on perch 1: starting its SDK failed: ModuleNotFoundError"),
    ],
)
def test_what_cannot_be_built_leaves_no_process(target: str, arguments: dict[str, Any], sentence: str) -> None:
    worker = Worker(target, arguments, "parrot on perch 1")
    with pytest.raises(DeviceError, match=sentence):
        worker.start(START_S)
    assert not worker.alive


def test_what_the_sdk_prints_is_not_ours(worker: Worker, capfd: pytest.CaptureFixture[str]) -> None:
    worker.start(START_S)
    for _ in range(3):  # more than is kept
        worker.call("chatter", 2 << 20, timeout_s=5.0)
    assert capfd.readouterr() == ("", "")


def test_interrupting_the_parent_does_not_reach_the_worker(worker: Worker) -> None:
    worker.start(START_S)
    os.kill(worker.call("pid", timeout_s=5.0), signal.SIGINT)
    assert worker.call("greet", "you", timeout_s=5.0) == "hello you"


def test_what_the_sdk_started_is_killed_with_it(worker: Worker) -> None:
    worker.start(START_S)
    child = worker.call("breed", timeout_s=5.0)
    worker.close()
    assert gone(child)


def test_a_worker_that_hangs_ends_with_a_parent_that_was_killed() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, cwd=Path(__file__).parents[2], text=True
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert not gone(pid, 0.2)
        parent.kill()
    assert gone(pid)


def test_a_worker_outlives_the_thread_that_started_it(worker: Worker) -> None:
    thread = threading.Thread(target=worker.start, args=(START_S,))
    thread.start()
    thread.join()
    assert worker.call("greet", "you", timeout_s=5.0) == "hello you"


def test_closing_from_another_thread_ends_a_call_that_hangs(worker: Worker) -> None:
    worker.start(START_S)
    timer = threading.Timer(0.2, worker.close)
    timer.start()
    start = time.monotonic()
    with pytest.raises(DeviceError, match="died during hang"):
        worker.call("hang", timeout_s=30.0)
    timer.join()
    assert time.monotonic() - start < 5.0


def test_a_raw_file_of_50_megabytes_arrives_within_a_second(worker: Worker) -> None:
    worker.start(START_S)
    start = time.monotonic()
    data = worker.call("file", 50_000_000, timeout_s=10.0)
    assert time.monotonic() - start < 1.0
    assert data == b"\xa5" * 50_000_000
