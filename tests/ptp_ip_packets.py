"""PTP/IP packets as CIPA DC-005 (clauses 2.2 to 2.4) lays them out: what driver and simulator agree on."""

from __future__ import annotations


def packed(text: str) -> bytes:
    return bytes.fromhex(text)


# length, kind, GUID of the initiator, its name "PC" in UTF-16 with a closing zero, version 1.0
INIT_COMMAND = packed("22 00 00 00 01 00 00 00" + "AB" * 16 + "50 00 43 00 00 00" + "00 00 01 00")
# connection number 1, GUID and name "C" of the responder, version 1.0
INIT_COMMAND_ACK = packed("24 00 00 00 02 00 00 00 01 00 00 00" + "CD" * 16 + "43 00 00 00" + "00 00 01 00")
INIT_EVENT = packed("0C 00 00 00 03 00 00 00 01 00 00 00")
INIT_EVENT_ACK = packed("08 00 00 00 04 00 00 00")
INIT_FAIL_REJECTED = packed("0C 00 00 00 05 00 00 00 01 00 00 00")
INIT_FAIL_BUSY = packed("0C 00 00 00 05 00 00 00 02 00 00 00")
# no data or data in, OpenSession, transaction 0, session 1
OPEN_SESSION = packed("16 00 00 00 06 00 00 00 01 00 00 00 02 10 00 00 00 00 01 00 00 00")
OPENED = packed("0E 00 00 00 07 00 00 00 01 20 00 00 00 00")
# data out, SetDevicePropValue, transaction 1, ExposureTime; 4 bytes announced; 100 ticks in the last packet of data
SET_EXPOSURE = packed("16 00 00 00 06 00 00 00 02 00 00 00 16 10 01 00 00 00 0D 50 00 00")
EXPOSURE_ANNOUNCED = packed("14 00 00 00 09 00 00 00 01 00 00 00 04 00 00 00 00 00 00 00")
EXPOSURE_10_MS = packed("10 00 00 00 0C 00 00 00 01 00 00 00 64 00 00 00")
EXPOSURE_SET = packed("0E 00 00 00 07 00 00 00 01 20 01 00 00 00")
# InitiateCapture, transaction 2
CAPTURE = packed("1A 00 00 00 06 00 00 00 01 00 00 00 0E 10 02 00 00 00 00 00 00 00 00 00 00 00")
CAPTURED = packed("0E 00 00 00 07 00 00 00 01 20 02 00 00 00")
OBJECT_ADDED = packed("12 00 00 00 08 00 00 00 02 40 00 00 00 00 01 00 00 00")
# GetObject, transaction 3, handle 1
GET_OBJECT = packed("16 00 00 00 06 00 00 00 01 00 00 00 09 10 03 00 00 00 01 00 00 00")
OBJECT_OF_5 = packed("14 00 00 00 09 00 00 00 03 00 00 00 05 00 00 00 00 00 00 00")
OBJECT_FIRST_3 = packed("0F 00 00 00 0A 00 00 00 03 00 00 00") + b"abc"
OBJECT_LAST_2 = packed("0E 00 00 00 0C 00 00 00 03 00 00 00") + b"de"
OBJECT_LAST_0 = packed("0C 00 00 00 0C 00 00 00 03 00 00 00")
OBJECT_SENT = packed("0E 00 00 00 07 00 00 00 01 20 03 00 00 00")
PROBE, PROBE_ANSWER = packed("08 00 00 00 0D 00 00 00"), packed("08 00 00 00 0E 00 00 00")
