"""What is particular to a PTP camera on a network; the host's packets are pinned to CIPA DC-005."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.ptp_camera import PtpCamera
from drivers.ptp_ip_pipe import PtpIpPipe
from drivers.ptp_pipe import PtpRefusedError, TruncatedTransferError
from drivers.ptp_protocol import Event, Operation, Property
from simulators.tcp import Session, TcpPort
from stage.errors import DeviceError, InputError
from stage.rig import PtpIp
from tests import ptp_ip_packets as packets

pytestmark = pytest.mark.system
CAPTURE_AND_FILE = {
    packets.OPEN_SESSION: packets.OPENED,
    packets.SET_EXPOSURE + packets.EXPOSURE_ANNOUNCED + packets.EXPOSURE_10_MS: packets.EXPOSURE_SET,
    packets.CAPTURE: packets.CAPTURED,
    packets.GET_OBJECT: packets.OBJECT_OF_5 + packets.OBJECT_FIRST_3 + packets.OBJECT_LAST_2 + packets.OBJECT_SENT,
}


class Script(Session):
    """A camera that knows some packets by heart, and keeps what else it hears."""

    def __init__(self, answers: dict[bytes, bytes]) -> None:
        self._answers = {packets.INIT_EVENT: packets.INIT_EVENT_ACK, **answers}
        self.heard = b""

    def feed(self, data: bytes) -> bytes:
        self.heard += data
        if self.heard[4:8] == packets.INIT_COMMAND[4:8]:
            self.greeting_heard, self.heard = self.heard, b""
            return self._answers.get(b"greeting", packets.INIT_COMMAND_ACK)
        answer = self._answers.get(self.heard)
        if answer is None:
            return b""
        self.heard = b""
        return answer


@contextmanager
def pipe_to(answers: dict[bytes, bytes]) -> Iterator[tuple[PtpIpPipe, list[Script]]]:
    """An open pipe, and the camera's two connections."""
    scripts: list[Script] = []

    def serve() -> Session:
        scripts.append(Script(answers))
        return scripts[-1]

    with TcpPort(serve) as port:
        pipe = PtpIpPipe((port.host, port.port), "camera C", answer_timeout_s=0.3)
        try:
            yield pipe, scripts
        finally:
            pipe.close()
            pipe.close()


def test_a_capture_packet_by_packet() -> None:
    with pipe_to({**CAPTURE_AND_FILE, packets.INIT_EVENT: packets.INIT_EVENT_ACK + packets.OBJECT_ADDED}) as (pipe, _):
        pipe.open()
        assert pipe.transact(Operation.OPEN_SESSION, 1) == ((), b"")
        encoded = struct.pack("<I", 100)
        assert pipe.transact(Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_TIME, data=encoded) == ((), b"")
        assert pipe.transact(Operation.INITIATE_CAPTURE, 0, 0) == ((), b"")
        assert pipe.event(1.0) == (Event.OBJECT_ADDED, (1,))
        assert pipe.event(0.01) is None
        assert pipe.transact(Operation.GET_OBJECT, 1) == ((), b"abcde")


def test_the_greeting_is_laid_out_as_the_standard_says_and_always_the_same() -> None:
    greetings = []
    for _ in range(2):
        with pipe_to({}) as (pipe, scripts):
            pipe.open()
            greetings.append(scripts[0].greeting_heard)
    first, second = greetings
    assert first == second  # a camera that was paired with this computer knows it again
    assert struct.unpack_from("<II", first) == (len(first), 1)
    assert first[24:-4] == "lightstage".encode("utf-16-le") + b"\0\0"
    assert first[-4:] == packets.INIT_COMMAND[-4:]


def test_probes_on_either_connection_are_answered() -> None:
    event_ack = packets.INIT_EVENT_ACK + packets.PROBE + packets.OBJECT_ADDED
    with pipe_to({packets.INIT_EVENT: event_ack, packets.OPEN_SESSION: packets.PROBE + packets.OPENED}) as found:
        pipe, scripts = found
        pipe.open()
        assert pipe.event(1.0) == (Event.OBJECT_ADDED, (1,))
        pipe.transact(Operation.OPEN_SESSION, 1)
        pipe.close()
    assert [script.heard for script in scripts] == [packets.PROBE_ANSWER, packets.PROBE_ANSWER]


def test_less_than_announced_is_a_torn_transfer() -> None:
    torn = packets.OBJECT_OF_5 + packets.OBJECT_FIRST_3 + packets.OBJECT_LAST_0 + packets.OBJECT_SENT
    with pipe_to({**CAPTURE_AND_FILE, packets.GET_OBJECT: torn}) as (pipe, _):
        pipe.open()
        pipe.transact(Operation.OPEN_SESSION, 1)
        pipe.transact(Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_TIME, data=struct.pack("<I", 100))
        pipe.transact(Operation.INITIATE_CAPTURE, 0, 0)
        with pytest.raises(TruncatedTransferError, match="camera C: GET_OBJECT ended after 3 bytes"):
            pipe.transact(Operation.GET_OBJECT, 1)


@pytest.mark.parametrize(
    ("greeting", "sentence"),
    [
        (packets.INIT_FAIL_REJECTED, "it refuses to connect: this host is not accepted; pair the camera with it"),
        (packets.INIT_FAIL_BUSY, "it refuses to connect: another program has it; close that one"),
        (packets.INIT_EVENT_ACK, "it answered by a packet of kind 4; check that it speaks PTP/IP"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", r"it sent a packet of \d+ bytes; check that it speaks PTP/IP"),
        (packets.INIT_COMMAND_ACK[:9], r"the request to connect was not answered for 0\.3 s; check"),
    ],
)
def test_what_may_come_back_instead_of_a_welcome(greeting: bytes, sentence: str) -> None:
    with pipe_to({b"greeting": greeting}) as (pipe, _), pytest.raises(DeviceError, match=f"camera C: {sentence}"):
        pipe.open()


@pytest.mark.parametrize(
    ("answer", "error", "sentence"),
    [
        (b"", DeviceError, r"OPEN_SESSION was not answered for 0\.3 s; check that the camera is awake"),
        (packets.EXPOSURE_SET, DeviceError, "OPEN_SESSION of transaction 0 was answered for transaction 1"),
        (
            bytes.fromhex("0E 00 00 00 07 00 00 00 19 20 00 00 00 00"),
            PtpRefusedError,
            r"OPEN_SESSION \['0x1'\] was refused: device busy \(0x2019\)",
        ),
    ],
)
def test_what_may_come_back_instead_of_an_answer(answer: bytes, error: type[Exception], sentence: str) -> None:
    with pipe_to({packets.OPEN_SESSION: answer}) as (pipe, _):
        pipe.open()
        with pytest.raises(error, match=f"camera C: {sentence}"):
            pipe.transact(Operation.OPEN_SESSION, 1)


def test_nobody_there_is_one_sentence() -> None:
    with TcpPort(lambda: Script({})) as port:
        address = (port.host, port.port)
    with pytest.raises(DeviceError, match=r"camera C: cannot connect: .*refused; check the address"):
        PtpIpPipe(address, "camera C").open()
    with pytest.raises(DeviceError, match="camera C: it is not connected; open it first"):
        PtpIpPipe(address, "camera C").event(0.1)


@pytest.mark.parametrize("port", [":15740", "camera.local:x", "camera.local:1:2"])
def test_addresses_that_are_none_are_refused(port: str) -> None:
    with pytest.raises(InputError, match=r"rig: camera\.device\.port: expected HOST or HOST:PORT, got"):
        PtpCamera.over_ip(PtpIp(driver="ptp-ip", port=port, exposure_s=0.02))


def test_the_port_may_be_left_to_the_standard() -> None:
    assert (
        PtpCamera.over_ip(PtpIp(driver="ptp-ip", port="10.0.0.5", exposure_s=0.02)).name == "camera at 10.0.0.5:15740"
    )
