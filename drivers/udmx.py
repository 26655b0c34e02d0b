"""uDMX: the lamp's levels as DMX512 channels, by USB control requests to the dongle of anyma and its clones.

The dongle does USB in firmware at low speed: a whole universe takes some 35 ms, and a transfer now and then stalls or
drops the dongle off the bus. So only the range of channels that changed is sent, a failed transfer is repeated with all
512, and a dongle that came back, which holds zeros, is sent all 512 as well.

References
----------
anyma, uDMX: common/uDMX_cmds.h (requests), firmware/main.c (their limits, frame timing, zeros after a restart).
"""

from __future__ import annotations

from typing import Any

from drivers.dmx import CHANNELS, DmxLamp
from drivers.usb_device import UsbError, UsbInterface, Wanted, find_device
from stage.clock import Clock, SystemClock
from stage.errors import DeviceError
from stage.rig import UdmxLight

VENDOR_ID, PRODUCT_ID = 0x16C0, 0x05DC
"""Shared by all hobby devices of the V-USB kind: the strings tell which is which."""
MAKER, PRODUCT = "www.anyma.ch", "uDMX"
SET_CHANNEL_RANGE = 2
VENDOR_OUT_TO_DEVICE = 0x40
TIMEOUT_S = 0.5
TRIES = 3
PAUSE_S = 0.02
FRAME_S = 0.045
"""All 512 channels, 44 us each, with the 37 us that the firmware leaves between them."""


class UdmxLamp(DmxLamp):
    """A lamp on a uDMX dongle: a `stage.devices.Lamp`.

    Parameters
    ----------
    light : UdmxLight
        Serial number of the dongle, and channels.
    clock : Clock, optional
        Waits for the DMX line to carry a new level; the system's where none is given.
    backend : usb.backend.IBackend, optional
        Where pyusb finds devices; the system's libusb where none is given.
    """

    def __init__(self, light: UdmxLight, *, clock: Clock | None = None, backend: Any = None) -> None:
        super().__init__(light.emitters, light.warm_up_s, clock or SystemClock())
        self._wanted = Wanted("uDMX dongle", "light", VENDOR_ID, PRODUCT_ID, light.serial, MAKER, PRODUCT)
        self._backend = backend
        self._usb: UsbInterface | None = None
        self._shown: bytes | None = None

    @property
    def name(self) -> str:
        """Device, and its serial number where the rig gives one."""
        return self._wanted.name

    def open(self) -> None:
        """Find the dongle, claim it, and go dark."""
        with self._cutoff.call(), self._cutoff.exchange():
            if self._usb is not None:
                return
            usb = UsbInterface(find_device(self._wanted, self._backend), self.name)
            try:
                usb.open()
                self._usb, self._shown = usb, None
                self.dark()
            except BaseException:
                self._disconnect()
                usb.close()
                raise
            self._in_use = True

    def close(self) -> None:
        """Let go of the dongle. It goes on sending its last levels: `make_safe` first."""
        self._in_use = False
        with self._cutoff.stop(), self._cutoff.exchange():
            self._disconnect()

    def _show(self, channels: bytes) -> float:
        if self._in_use:
            self.open()
        if self._usb is None:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        for left in reversed(range(TRIES)):
            try:
                self._transfer(self._usb, channels)
                break
            except UsbError as error:
                self._shown = None
                if not left or not error.may_pass:
                    self._disconnect()
                    raise
                self._cutoff.sleep(PAUSE_S)
        self._shown = channels
        return FRAME_S

    def _transfer(self, usb: UsbInterface, channels: bytes) -> None:
        first, stop = 0, CHANNELS
        if self._shown is not None:
            changed = [i for i in range(CHANNELS) if channels[i] != self._shown[i]]
            # where nothing changed one channel is sent all the same, to hear that the dongle is there
            first, stop = (changed[0], changed[-1] + 1) if changed else (0, 1)
        what = f"SetChannelRange of channels {first + 1} to {stop} (request {SET_CHANNEL_RANGE})"
        data = channels[first:stop]
        usb.tell(what, VENDOR_OUT_TO_DEVICE, SET_CHANNEL_RANGE, len(data), first, data, TIMEOUT_S)

    def _disconnect(self) -> None:
        usb, self._usb = self._usb, None
        if usb is not None:
            usb.close()
