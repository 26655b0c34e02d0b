"""Alerts: what needs somebody gets through to a hook that answers, and a hook that does not harms nobody."""

from __future__ import annotations

import base64
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, get_args

import pytest

from acquisition import alerts
from acquisition.alerts import TRIES, CommandAlert, HookAlert, WebhookAlert, alert_for
from acquisition.session.states import SessionStatus
from acquisition.taken import EventKind, SessionEvent
from stage.errors import InputError

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def _nothing_is_left(monkeypatch) -> Iterator[None]:
    monkeypatch.setenv("no_proxy", "*")
    before = threading.active_count()
    yield
    assert threading.active_count() == before


def event(kind: Any = "suspended", message: str = "door: the door is open", shot: int | None = None) -> SessionEvent:
    return SessionEvent(time="2026-11-22T12:00:00+00:00", kind=kind, message=message, shot=shot)


def status(outcome: str | None = None, **options: Any) -> SessionStatus:
    values: dict[str, Any] = {
        "phase": "suspended" if outcome is None else "ended",
        "outcome": outcome,
        "reason": "",
        "run": 1,
        "shots": 60,
        "taken": 12,
        "shot": None,
        "retakes": (),
        "skipped": (),
        "elapsed_s": 31.5,
        "remaining_s": 126.0,
        "live": None,
    }
    return SessionStatus.model_validate(values | options)


class Server:
    """An HTTP server that answers with what it is told, in turn; the last answer stays."""

    def __init__(self, *answers: int, location: str = "") -> None:
        self.heard: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.paths: list[str] = []
        left = list(answers)
        ours = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                ours.paths.append(self.path)
                ours.headers.append(dict(self.headers))
                ours.heard.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                self.send_response(left.pop(0) if len(left) > 1 else left[0])
                if location:
                    self.send_header("Location", location)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *args: Any) -> None: ...

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()
        self.host = f"127.0.0.1:{self._server.server_port}"
        self.url = f"http://{self.host}/hook"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@contextmanager
def served(*answers: int, **options: Any) -> Iterator[Server]:
    server = Server(*answers, **options)
    try:
        yield server
    finally:
        server.close()


@contextmanager
def listening(talk: Callable[[socket.socket], object]) -> Iterator[str]:
    """Address of a server that does something else than answer with HTTP, on every connection."""
    done = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.02)

        def accept() -> None:
            wires = []
            while not done.is_set():
                try:
                    wires.append(listener.accept()[0])
                    talk(wires[-1])
                except OSError:
                    continue
            for wire in wires:
                wire.close()

        thread = threading.Thread(target=accept)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
        finally:
            done.set()
            thread.join()


def told(alert: HookAlert, *events: SessionEvent, wait_s: float = 30.0) -> float:
    """Tell a hook of events and close it; returns how long the session was kept waiting before that."""
    begun = time.monotonic()
    for one in events:
        alert(one)
    kept = time.monotonic() - begun
    alert.close(wait_s)
    return kept


def until(so: Callable[[], object], within_s: float = 20.0) -> None:
    deadline = time.monotonic() + within_s
    while not so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


# What gets through


def test_a_web_address_gets_event_session_and_progress(tmp_path):
    notes: list[str] = []
    with served(200) as server:
        alert = WebhookAlert(server.url, tmp_path / "bear", note=notes.append)
        alert.follow(status)
        told(alert, event(shot=7))
    [heard] = server.heard
    assert heard == {
        "event": "suspended",
        "message": "door: the door is open",
        "time": "2026-11-22T12:00:00+00:00",
        "shot": 7,
        "session": str(tmp_path / "bear"),
        "progress": {
            "phase": "suspended",
            "outcome": None,
            "run": 1,
            "shots": 60,
            "taken": 12,
            "elapsed_s": 31.5,
            "remaining_s": 126.0,
        },
        "text": "lightstage: bear: suspended: door: the door is open (12 of 60 shots taken)",
    }
    assert server.headers[0]["Content-Type"] == "application/json"
    assert "Authorization" not in server.headers[0]
    assert notes == []


def test_a_command_gets_the_same_on_its_stdin(tmp_path):
    notes: list[str] = []
    alert = CommandAlert(["tee", str(tmp_path / "told.json")], tmp_path / "Bär", note=notes.append)
    told(alert, event(message="Tür offen"))
    heard = json.loads((tmp_path / "told.json").read_text())
    assert (heard["event"], heard["message"], heard["progress"]) == ("suspended", "Tür offen", None)
    assert heard["text"] == "lightstage: Bär: suspended: Tür offen"
    assert notes == []


def test_only_what_needs_somebody_is_told(tmp_path):
    with served(200) as server:
        told(WebhookAlert(server.url, tmp_path), *(event(kind) for kind in get_args(EventKind)))
    heard = [one["event"] for one in server.heard]
    assert sorted(heard) == sorted(["operator", "suspended", "skipped", "faulty", "emergency-stop", "ended"])


@pytest.mark.parametrize(("outcome", "count"), [("completed", 0), ("stopped", 1), ("aborted", 1), ("failed", 1)])
def test_an_end_is_told_unless_all_was_taken(tmp_path, outcome, count):
    with served(200) as server:
        alert = WebhookAlert(server.url, tmp_path)
        alert.follow(lambda: status(outcome))
        told(alert, event("ended", outcome))
    assert len(server.heard) == count


def test_what_may_come_with_every_shot_is_told_once_in_a_while(tmp_path, monkeypatch):
    with served(200) as server:
        alert = WebhookAlert(server.url, tmp_path)
        told(alert, *(event(kind, shot=shot) for shot in range(50) for kind in ("skipped", "faulty")))
    assert sorted((one["event"], one["shot"]) for one in server.heard) == [("faulty", 0), ("skipped", 0)]
    monkeypatch.setattr(alerts, "QUIET_S", 0.0)
    with served(200) as server:
        told(WebhookAlert(server.url, tmp_path), *(event("skipped", shot=shot) for shot in range(3)))
    assert len(server.heard) == 3


def test_a_message_of_any_length_fits(tmp_path):
    folder = tmp_path.joinpath(*["ä" * 100] * 15)
    with served(200) as server:
        alert = WebhookAlert(server.url + "?" + "x" * 1900, folder)
        alert.follow(lambda: status(skipped=tuple(range(5000))))
        told(alert, event(message="😀" * 100_000))
    assert server.heard[0]["message"] == "😀" * 1000
    assert server.heard[0]["session"] == str(folder)


# What is secret


def test_user_and_password_are_sent_and_shown_nowhere(tmp_path):
    notes: list[str] = []
    with served(403) as server:
        secret = f"http://ann:pa%3Ass@{server.host}/services/T0/SECRET?token=SECRET#SECRET"
        told(WebhookAlert(secret, tmp_path, note=notes.append), event())
    assert server.headers[0]["Authorization"] == "Basic " + base64.b64encode(b"ann:pa:ss").decode()
    assert server.paths == ["/services/T0/SECRET?token=SECRET"]
    assert notes == [f"alert: http://{server.host} answers 403; it was not told: suspended: door: the door is open"]


@pytest.mark.parametrize(
    "url",
    [
        "ftp://ann:SECRET@host/",
        "http://",
        "https:///SECRET",
        "http://host:SECRET/",
        "http://[SECRET/",
        "http://host/SECRET path",
        "http://host/SECRET\npath",
        "https://host/" + "SECRET" * 1000,
    ],
)
def test_an_address_that_is_none_is_refused_and_not_shown(tmp_path, url):
    with pytest.raises(InputError, match=r"--alert: is no .*address; expected one such as") as refusal:
        WebhookAlert(url, tmp_path)
    assert "SECRET" not in str(refusal.value)


# Servers in trouble


def test_a_server_that_fails_is_asked_again(tmp_path):
    notes: list[str] = []
    with served(500, 503, 429, 200) as server:
        alert = WebhookAlert(server.url, tmp_path, note=notes.append, pause_s=0.01)
        alert(event())
        until(lambda: len(server.heard) == 4)
        alert.close()
    assert notes == []


def test_a_server_that_always_fails_is_given_up(tmp_path):
    notes: list[str] = []
    with served(500) as server:
        alert = WebhookAlert(server.url, tmp_path, note=notes.append, pause_s=0.01)
        alert(event())
        until(lambda: notes)
        alert.close()
    assert len(server.heard) == TRIES
    assert notes[0].startswith(f"alert: http://{server.host} answers 500, in {TRIES} tries; it was not told: suspended")


def test_a_redirect_is_not_followed(tmp_path):
    notes: list[str] = []
    with served(200) as other, served(302, location=other.url) as server:
        told(WebhookAlert(server.url, tmp_path, note=notes.append), event())
    assert (len(server.heard), len(other.heard)) == (1, 0)
    assert "answers 302; give the address that it redirects to" in notes[0]


def test_a_server_that_refuses_or_has_no_name(tmp_path, monkeypatch):
    monkeypatch.setattr(alerts, "TRIES", 1)
    notes: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    told(WebhookAlert(f"http://127.0.0.1:{port}/", tmp_path, note=notes.append), event())
    assert f"http://127.0.0.1:{port} cannot be reached (Connection refused)" in notes[0]
    told(WebhookAlert("http://lightstage.invalid/", tmp_path, note=notes.append), event(), wait_s=2)
    assert "http://lightstage.invalid" in notes[1]


@pytest.mark.parametrize(
    ("talk", "says"),
    [
        (lambda wire: None, "does not answer"),
        (lambda wire: wire.sendall(b"HTTP/1.1 200"), "does not answer"),
        (lambda wire: wire.close(), "it was not told"),
        (lambda wire: wire.sendall(b"220 smtp ready\r\n"), "does not answer as a web server does (BadStatusLine)"),
    ],
    ids=["silent", "half", "hangs-up", "smtp"],
)
def test_a_server_that_is_none(tmp_path, monkeypatch, talk, says):
    monkeypatch.setattr(alerts, "ANSWER_S", 0.2)
    monkeypatch.setattr(alerts, "TRIES", 1)
    notes: list[str] = []
    with listening(talk) as url:
        told(WebhookAlert(url, tmp_path, note=notes.append), event())
    assert says in notes[0]


def test_a_server_that_trickles_is_cut_off(tmp_path, monkeypatch):
    monkeypatch.setattr(alerts, "HOOK_S", 0.5)
    monkeypatch.setattr(alerts, "TRIES", 1)
    notes: list[str] = []
    done = threading.Event()

    def trickle(wire: socket.socket) -> None:
        while not done.is_set():
            wire.sendall(b"x")
            time.sleep(0.05)

    with listening(trickle) as url:
        told(WebhookAlert(url, tmp_path, note=notes.append), event())
        done.set()
    assert "does not answer in time" in notes[0]


# Commands in trouble


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["sh", "-c", "echo no route; exit 2"], "the command sh ended with exit status 2 (no route), in 5 tries"),
        (["false"], "the command false ended with exit status 1, in 5 tries"),
        (["/nowhere/mail"], "the command /nowhere/mail cannot be run (No such file or directory); it was not told"),
    ],
)
def test_a_command_that_fails_is_noted(tmp_path, command, says):
    notes: list[str] = []
    alert = CommandAlert(command, tmp_path, note=notes.append, pause_s=0.01)
    alert(event())
    until(lambda: notes)
    alert.close()
    assert says in notes[0]


def test_a_command_that_hangs_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(alerts, "HOOK_S", 0.2)
    monkeypatch.setattr(alerts, "TRIES", 1)
    notes: list[str] = []
    told(CommandAlert(["sleep", "300"], tmp_path, note=notes.append), event())
    assert "the command sleep did not end within 0.2 s; it was not told: suspended" in notes[0]


def test_a_person_who_cannot_be_told_does_not_end_the_alerts(tmp_path):
    def note(sentence: str) -> None:
        raise BrokenPipeError("the terminal is gone")

    log = tmp_path / "told"
    script = f'read line; case $line in *first*) exit 7;; *) echo "$line" > {log};; esac'
    alert = CommandAlert(["sh", "-c", script], tmp_path, note=note, pause_s=0.01)
    alert(event(message="first"))
    alert(event(message="second"))
    until(log.exists)
    alert.close()
    assert '"second"' in log.read_text()


# The session does not wait, and the last word goes out


def test_a_hook_that_hangs_keeps_no_session_waiting(tmp_path):
    notes: list[str] = []
    alert = CommandAlert(["sleep", "300"], tmp_path, note=notes.append)
    begun = time.monotonic()
    assert told(alert, *(event() for _ in range(1000)), wait_s=0.3) < 1
    assert time.monotonic() - begun < 10
    assert sum(int(part) for part in notes[-1].split() if part.isdigit()) + len(notes) - 1 == 1000
    assert "were never sent" in notes[-1]


def test_the_last_alert_goes_out_although_the_hook_is_stuck_with_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr(alerts, "HOOK_S", 0.5)
    log = tmp_path / "told"
    script = f'read line; case $line in *\'"ended"\'*) echo "$line" >> {log};; *) sleep 300;; esac'
    alert = CommandAlert(["sh", "-c", script], tmp_path)
    alert(event("suspended"))
    alert(event("suspended"))
    alert(event("ended", "failed"))
    begun = time.monotonic()
    alert.close(2.0)
    assert time.monotonic() - begun < 8
    assert json.loads(log.read_text())["event"] == "ended"


def test_a_pause_before_another_try_is_cut_short_at_the_end(tmp_path):
    with served(500, 200) as server:
        alert = WebhookAlert(server.url, tmp_path, pause_s=300)
        alert(event())
        until(lambda: server.heard)
        begun = time.monotonic()
        alert.close()
        assert time.monotonic() - begun < 10
    assert len(server.heard) == 2


def test_closing_is_quick_where_there_is_nothing_to_say_and_may_be_repeated(tmp_path):
    begun = time.monotonic()
    with CommandAlert(["false"], tmp_path) as alert:
        pass
    alert.close()
    alert(event())  # a late one disturbs nobody
    assert time.monotonic() - begun < 1


# As a person asks for it


def test_a_hook_is_an_address_or_a_command(tmp_path):
    with alert_for("https://ann@example.org/x", tmp_path) as alert:
        assert isinstance(alert, WebhookAlert)
        assert alert.name == "https://example.org"
    with alert_for("tee 'a file'", tmp_path) as alert:
        assert isinstance(alert, CommandAlert)
        assert alert.name == "the command tee"


@pytest.mark.parametrize(
    ("hook", "says"),
    [
        ("", "--alert: expected an http or https address, or a command that is there, got ''"),
        ("no-such-command --now", "--alert: expected an http or https address, or a command that is there"),
        ("mail 'unfinished", "--alert: is no command line"),
        ("ftp://example.org", "--alert: is no http or https address"),
    ],
)
def test_a_hook_that_is_neither_is_refused_at_once(tmp_path: Path, hook: str, says: str):
    with pytest.raises(InputError, match=says):
        alert_for(hook, tmp_path)
