"""Commands from another terminal: they arrive, refusals say why, and no client can be in another's way."""

from __future__ import annotations

import json
import random
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from acquisition.session.states import Phase, SessionStatus
from api import session_control
from api.session_control import COMMANDS, CONNECTIONS, LINE_BYTES, SOCKET, ask, controlled
from api.verbs.controlling import session as verb
from stage.errors import DeviceError, InputError

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    before = threading.active_count()
    yield
    assert threading.active_count() == before


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out" / "capture").mkdir(parents=True)
    return tmp_path / "out"


class Ordered:
    """A session that notes what it is asked, and does nothing."""

    def __init__(self) -> None:
        self.phase = Phase.RUNNING
        self.asked: list[tuple[Any, ...]] = []
        self.unsafe: list[DeviceError] = []
        self.slow = threading.Event()
        self.slow.set()

    def pause(self, reason: str) -> None:
        self.asked.append(("pause", reason))
        self.phase = Phase.PAUSED

    def resume(self) -> None:
        self.asked.append(("resume",))
        self.phase = Phase.RUNNING

    def stop(self, reason: str) -> None:
        self.asked.append(("stop", reason))

    def abort(self, reason: str) -> None:
        self.asked.append(("abort", reason))

    def skip(self, reason: str) -> None:
        self.asked.append(("skip", reason))

    def retake(self, shot: int, reason: str) -> None:
        if shot > 59:
            raise InputError(f"shot: expected an index from 0 to 59, got {shot}")
        self.asked.append(("retake", shot, reason))

    def emergency_stop(self, reason: str) -> list[DeviceError]:
        self.asked.append(("emergency-stop", reason))
        return self.unsafe

    def status(self) -> SessionStatus:
        self.slow.wait(20)
        return SessionStatus(
            phase=self.phase.value,
            outcome=None,
            reason="",
            run=1,
            shots=60,
            taken=12,
            shot="0012-light-12",
            retakes=(),
            skipped=(),
            elapsed_s=31.5,
            remaining_s=126.0,
            live=None,
        )


def until(so: Callable[[], object], within_s: float = 20.0) -> None:
    deadline = time.monotonic() + within_s
    while not so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def connected(out: Path) -> socket.socket:
    wire = socket.socket(socket.AF_UNIX)
    wire.connect(str(out / "capture" / SOCKET))
    wire.settimeout(20)
    return wire


def said(wire: socket.socket) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(wire.makefile().readline())
    return answer


# What arrives


def test_every_command_arrives_with_its_reason(out):
    session = Ordered()
    with controlled(session, out / "capture"):
        for command in ("status", "pause", "resume", "skip", "stop", "abort", "emergency-stop"):
            found = ask(out, command, reason="a visitor")
            assert found["status"] == session.status().model_dump(mode="json")
            assert found["unsafe"] == []
        ask(out, "retake", shot=7)
    assert session.asked == [
        ("pause", "a visitor"),
        ("resume",),
        ("skip", "a visitor"),
        ("stop", "a visitor"),
        ("abort", "a visitor"),
        ("emergency-stop", "a visitor"),
        ("retake", 7, "asked for from another terminal"),
    ]


def test_several_commands_over_one_connection_in_pieces_of_any_size(out):
    session, rng = Ordered(), random.Random(4)
    text = b"".join(json.dumps({"command": "skip", "reason": f"{n}"}).encode() + b"\n" for n in range(20))
    with controlled(session, out / "capture"), connected(out) as wire:
        while text:
            size = rng.randint(1, 40)
            wire.sendall(text[:size])
            text = text[size:]
        answers = wire.makefile()
        assert all(json.loads(answers.readline())["ok"] for _ in range(20))
    assert session.asked == [("skip", f"{n}") for n in range(20)]


# Refusals


@pytest.mark.parametrize(
    ("phase", "command", "says"),
    [
        (Phase.RUNNING, "resume", "the session is running, so there is nothing to resume"),
        (Phase.SUSPENDED, "resume", "the session is suspended, so there is nothing to resume"),
        (Phase.STOPPING, "pause", "the session is stopping, so there is nothing to pause"),
        (Phase.ENDED, "stop", "the session is ended, so there is nothing to stop"),
        (Phase.STOPPING, "retake", "the session is stopping, so there is nothing to retake"),
    ],
)
def test_a_command_that_makes_no_sense_now_is_refused(out, phase, command, says):
    session = Ordered()
    session.phase = phase
    with controlled(session, out / "capture"), pytest.raises(InputError) as refusal:
        ask(out, command, shot=1 if command == "retake" else None)
    assert str(refusal.value) == f"{out}: command: {says}"
    assert session.asked == []


@pytest.mark.parametrize("phase", list(Phase))
def test_an_emergency_stop_is_refused_in_no_phase(out, phase):
    session = Ordered()
    session.phase = phase
    with controlled(session, out / "capture"):
        ask(out, "emergency-stop")
    assert session.asked


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"{", "invalid JSON"),
        (b"\xff\xfe", "invalid JSON"),
        (b"[]", "object"),
        (b'{"command": "fly"}', "command: "),
        (b'{"command": "stop", "colour": 1}', "colour: unknown key"),
        (b'{"command": "stop", "reason": ""}', "reason: "),
        (b'{"command": "retake"}', "shot: retake needs the number of a shot"),
        (b'{"command": "retake", "shot": "x"}', "shot: "),
        (b'{"command": "retake", "shot": 60}', "shot: expected an index from 0 to 59, got 60"),
        (b"[" * 4000, "invalid JSON"),
    ],
)
def test_garbage_is_answered_with_one_sentence_and_the_next_line_is_heard(out, line, says):
    with controlled(Ordered(), out / "capture"), connected(out) as wire:
        wire.sendall(line + b"\n")
        answer = said(wire)
        assert not answer["ok"]
        assert says in answer["error"]
        assert not answer["error"].startswith(":")
        wire.sendall(b'{"command": "status"}\n')
        assert said(wire)["ok"]


def test_nobody_at_home(tmp_path, out):
    for place in (out, tmp_path / "nowhere", out / "capture" / SOCKET):
        with pytest.raises(InputError, match="no session is running here"):
            ask(place, "status")
    (out / "capture" / SOCKET).write_text("nonsense\0" * 3)
    with pytest.raises(InputError, match="no session is running here"):
        ask(out, "status")


def test_the_verb_refuses_what_is_no_command(out):
    with pytest.raises(InputError, match=r"session: expected one of status, pause, .*, got 'fly'"):
        verb(out, "fly")
    for command, shot in (("retake", None), ("pause", 3)):
        with pytest.raises(InputError, match="retake needs the number of a shot, and nothing else takes one"):
            verb(out, command, shot=shot)


def test_a_reason_of_any_writing_fits_and_a_longer_one_is_refused(out):
    session = Ordered()
    with controlled(session, out / "capture"):
        ask(out, "pause", reason="😀" * 500)
        for reason in ("", "x" * 501):
            with pytest.raises(InputError, match=f"--reason: expected 1 to 500 characters, got {len(reason)}"):
                ask(out, "pause", reason=reason)
    assert session.asked == [("pause", "😀" * 500)]


def test_what_could_not_be_made_safe_is_said(out):
    session = Ordered()
    session.unsafe = [DeviceError("lamp on COM3: does not answer; switch it off")]
    with controlled(session, out / "capture"), pytest.raises(DeviceError, match="could not be made safe: lamp on COM3"):
        verb(out, "emergency-stop")


def test_a_session_that_cannot_say_where_it_is_answers_all_the_same(out, monkeypatch):
    session = Ordered()
    monkeypatch.setattr(session, "status", lambda: [][0])
    with controlled(session, out / "capture"), pytest.raises(InputError, match=r"failed with IndexError"):
        ask(out, "emergency-stop")
    assert session.asked


def test_a_session_that_hangs_is_told_apart_from_none(out, monkeypatch):
    monkeypatch.setattr(session_control, "ANSWER_S", 0.2)
    session = Ordered()
    session.slow.clear()
    with controlled(session, out / "capture"):
        with pytest.raises(DeviceError, match=r"has not answered status within 0\.2 s; interrupt it where it runs"):
            ask(out, "status")
        session.slow.set()


# Clients in the way


def test_an_emergency_stop_waits_for_nobody(out):
    session = Ordered()
    with controlled(session, out / "capture"):
        silent = [connected(out) for _ in range(3 * CONNECTIONS)]
        session.slow.clear()
        for wire in silent[-CONNECTIONS:]:
            wire.sendall(b'{"command": "status"}\n' * 50)  # each of them is stuck in the session
        with connected(out) as wire:
            begun = time.monotonic()
            wire.sendall(b'{"command": "emergency-stop"}\n')
            until(lambda: session.asked)
            assert time.monotonic() - begun < 2
            session.slow.set()
            assert said(wire)["ok"]
        for wire in silent:
            wire.close()


def test_clients_that_vanish_or_never_end_a_line_are_forgotten(out):
    session, rng = Ordered(), random.Random(1)
    with controlled(session, out / "capture"):
        for _ in range(100):
            with connected(out) as wire:
                wire.sendall(rng.choice([b"", b"{", b'{"command": "status"}\n', rng.randbytes(100)]))
        with connected(out) as wire:
            wire.sendall(b"x" * (LINE_BYTES + 1))
            assert wire.recv(100) == b""
        assert ask(out, "status")["ok"]


def test_a_client_that_does_not_read_is_not_waited_for(out, monkeypatch):
    monkeypatch.setattr(session_control, "IDLE_S", 0.2)
    monkeypatch.setattr(session_control, "CLOSE_S", 0.5)
    with controlled(Ordered(), out / "capture"):
        deaf = connected(out)
        deaf.setblocking(False)
        with suppress(BlockingIOError):
            for _ in range(100_000):
                deaf.send(b'{"command": "status"}\n')
        begun = time.monotonic()
    assert time.monotonic() - begun < 10
    deaf.close()


def test_an_answer_that_is_under_way_goes_out_although_the_session_ends(out):
    session = Ordered()
    session.slow.clear()
    answers: list[dict[str, Any]] = []
    with controlled(session, out / "capture"):
        client = threading.Thread(target=lambda: answers.append(ask(out, "abort")))
        client.start()
        until(lambda: session.asked)
        threading.Timer(0.3, session.slow.set).start()
    client.join()
    assert answers[0]["ok"]


# The socket


def test_the_socket_is_its_owners_and_gone_afterwards(out):
    with controlled(Ordered(), out / "capture"):
        mode = (out / "capture" / SOCKET).stat().st_mode
        assert stat.S_ISSOCK(mode)
        assert stat.S_IMODE(mode) == 0o600
    assert list((out / "capture").iterdir()) == []


def test_the_socket_goes_with_a_session_that_fails(out):
    with pytest.raises(DeviceError, match="boom"), controlled(Ordered(), out / "capture"):
        raise DeviceError("boom")
    assert list((out / "capture").iterdir()) == []


def test_what_a_killed_session_has_left_is_replaced(out):
    program = (
        "import os, sys; from pathlib import Path; from api.session_control import controlled\n"
        "with controlled(None, Path(sys.argv[1])): os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", program, str(out / "capture")], check=False)
    assert (out / "capture" / SOCKET).exists()
    with pytest.raises(InputError, match="no session is running here"):
        ask(out, "status")
    with controlled(Ordered(), out / "capture"):
        assert ask(out, "status")["ok"]


@pytest.fixture
def runtime() -> Iterator[Path]:
    """A folder whose name is short enough for a socket in it, as pytest's own need not be."""
    with tempfile.TemporaryDirectory(prefix="ls-") as folder:
        yield Path(folder)


@pytest.mark.parametrize("killed", [False, True])
def test_a_folder_whose_name_is_too_long_for_a_socket(tmp_path, monkeypatch, killed, runtime):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    out = tmp_path / ("x" * 100)
    (out / "capture").mkdir(parents=True)
    if killed:
        left = runtime / "lightstage-0" / SOCKET
        left.parent.mkdir()
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(left))
        (out / "capture" / SOCKET).write_text(f"{left}\n")
    with controlled(Ordered(), out / "capture"):
        assert ask(out, "status")["ok"]
        [folder] = runtime.iterdir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert list(runtime.iterdir()) == list((out / "capture").iterdir()) == []


def test_a_file_that_a_foreign_record_names_is_not_removed(out, tmp_path):
    mine = tmp_path / "mine"
    mine.write_text("keep")
    (out / "capture" / SOCKET).write_text(str(mine))
    with controlled(Ordered(), out / "capture"):
        assert ask(out, "status")["ok"]
    assert mine.read_text() == "keep"


def test_a_session_goes_on_where_no_socket_can_be(out, monkeypatch):
    monkeypatch.setattr(session_control, "_bound", lambda place: (_ for _ in ()).throw(OSError(95, "Not supported")))
    notes: list[str] = []
    with controlled(Ordered(), out / "capture", notes.append):
        pass
    assert notes == [f"{out / 'capture'}: the session cannot be controlled from another terminal (Not supported)"]
    assert list((out / "capture").iterdir()) == []


def test_a_folder_that_vanishes_meanwhile_is_no_trouble(out):
    with controlled(Ordered(), out / "capture"):
        (out / "capture").rename(out / "away")
    assert [path.name for path in out.iterdir()] == ["away"]


def test_the_commands_are_the_sessions():
    assert COMMANDS == ("status", "pause", "resume", "stop", "abort", "emergency-stop", "skip", "retake")


# The command line


def test_the_command_line_steers_a_session_and_says_where_it_is(run, out):
    session = Ordered()
    with controlled(session, out / "capture"):
        found = run("session", out, "pause", "--reason", "a visitor", "--json")
        assert (found.code, found.json["phase"], found.json["taken"]) == (0, "paused", 12)
        shown = run("session", out, "status").stdout
        assert run("session", out, "retake", 7).code == 0
        refusal = run("session", out, "pause", 7)
    assert session.asked == [("pause", "a visitor"), ("retake", 7, "asked for from another terminal")]
    assert "12 of 60" in shown
    assert refusal.code == 2


def test_the_command_line_refuses_in_one_sentence(refused, out):
    assert f"{out}: no session is running here" in refused("session", out, "status")
    assert "expected one of status" in refused("session", out, "fly")


def test_a_client_loads_nothing_that_takes_long():
    program = (
        "import sys, api.verbs.controlling\n"
        "sys.exit(any(name in sys.modules for name in ('numpy', 'cv2', 'acquisition.session')))"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
