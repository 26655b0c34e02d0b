"""Bytes as the documentation of Grbl 1.1 ("Interface") prints them, for driver and simulator alike."""

from __future__ import annotations

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
UNLOCK = b"[MSG:'$H'|'$X' to unlock]\r\n"
SETTINGS = (
    b"$0=10\r\n$1=25\r\n$2=0\r\n$3=0\r\n$4=0\r\n$5=0\r\n$6=0\r\n$10=255\r\n$11=0.010\r\n$12=0.002\r\n$13=0\r\n"
    b"$20=0\r\n$21=0\r\n$22=0\r\n$23=0\r\n$24=25.000\r\n$25=500.000\r\n$26=250\r\n$27=1.000\r\n$30=1000\r\n$31=0\r\n"
    b"$32=0\r\n$100=250.000\r\n$101=250.000\r\n$102=250.000\r\n$110=500.000\r\n$111=500.000\r\n$112=500.000\r\n"
    b"$120=10.000\r\n$121=10.000\r\n$122=10.000\r\n$130=200.000\r\n$131=200.000\r\n$132=200.000\r\nok\r\n"
)
BUILD = b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
REPORT = b"<Idle|MPos:0.000,-10.000,5.000|Bf:15,128|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
