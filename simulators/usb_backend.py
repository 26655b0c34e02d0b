"""USB devices that exist only in this process, for unchanged pyusb.

`VirtualUsb` is a pyusb back-end: hand it to a driver, or to `usb.core.find(backend=...)`.
"""

from __future__ import annotations

import array
import errno
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, Protocol

import usb.backend
import usb.core

BULK, INTERRUPT = 2, 3
LANGUAGE_EN_US = 0x0409
GET_DESCRIPTOR, STRING_DESCRIPTOR = 0x06, 0x03
CONFIGURATION = 1


class UsbStallError(Exception):
    """A device does not take what it was sent, and stalls the pipe: a bulk pipe until the host clears it."""


class UsbSilentError(Exception):
    """A device keeps the host waiting until that gives up."""


class UsbGoneError(Exception):
    """A device has dropped off the bus and come back as a new one, for which nobody holds a handle yet."""


class Clock(Protocol):
    """Time that reads wait in."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...


class UsbFunction(Protocol):
    """A device with one configuration and one interface.

    Attributes
    ----------
    vendor_id, product_id : int
        USB ids.
    interface_class : (3,) int
        Class, subclass and protocol of the interface.
    endpoints : tuple of (address, transfer type, packet size)
        Of the interface.
    strings : (3,) str
        Maker, product and serial number.
    """

    vendor_id: int
    product_id: int
    interface_class: tuple[int, int, int]
    endpoints: tuple[tuple[int, int, int], ...]
    strings: tuple[str, str, str]

    def host_sends(self, endpoint: int, data: bytes) -> None:
        """Take what the host writes to an endpoint."""
        ...

    def host_reads(self, endpoint: int, size: int) -> bytes | None:
        """What a read of an endpoint gets, or None where there is nothing yet."""
        ...

    def ready_s(self, endpoint: int) -> float | None:
        """When there will be something to read, or None where that is not known."""
        ...

    def control(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        """Answer a control request, or raise `UsbStallError` or `UsbSilentError`."""
        ...


class _Handle:
    def __init__(self, device: UsbFunction, visit: int) -> None:
        self.device, self.visit = device, visit


class VirtualUsb(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """A bus with virtual devices on it.

    Parameters
    ----------
    clock : Clock
        Reads wait in this time, so that a rehearsal does not wait at all.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._devices: list[UsbFunction] = []
        self._claims: dict[int, _Handle] = {}
        self._visits: Counter[int] = Counter()
        self._halted: set[tuple[int, int]] = set()

    def plug_in(self, device: UsbFunction) -> None:
        """Let a device appear."""
        if device not in self._devices:
            self._devices.append(device)
            self._visits[id(device)] += 1

    def unplug(self, device: UsbFunction) -> None:
        """Let a device vanish, even under a driver that has it open."""
        if device in self._devices:
            self._devices.remove(device)
            self._claims.pop(id(device), None)
            self._halted -= {(id(device), address) for address, _, _ in device.endpoints}

    def enumerate_devices(self) -> Any:
        """All devices on the bus."""
        return iter(list(self._devices))

    def get_parent(self, dev: UsbFunction) -> None:
        """Return None: devices hang on the root."""
        return

    def get_device_descriptor(self, dev: UsbFunction) -> SimpleNamespace:
        """USB 2.0 device descriptor."""
        place = self._devices.index(dev) + 1 if dev in self._devices else 0
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=dev.vendor_id, idProduct=dev.product_id, bcdDevice=0x0100,
            iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
            address=place, bus=1, port_number=place, port_numbers=(place,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: UsbFunction, config: int) -> SimpleNamespace:
        """The one configuration."""
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=18 + 7 * len(dev.endpoints), bNumInterfaces=1,
            bConfigurationValue=CONFIGURATION, iConfiguration=0, bmAttributes=0x80, bMaxPower=50,
            extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: UsbFunction, intf: int, alt: int, config: int) -> SimpleNamespace:
        """The one interface."""
        if intf or alt:
            raise IndexError(intf)
        kind, subclass, protocol = dev.interface_class
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=len(dev.endpoints),
            bInterfaceClass=kind, bInterfaceSubClass=subclass, bInterfaceProtocol=protocol, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: UsbFunction, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """One endpoint."""
        address, kind, packet = dev.endpoints[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=packet,
            bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: UsbFunction) -> _Handle:
        """Open; claiming an interface is what excludes others."""
        handle = _Handle(dev, self._visits[id(dev)])
        self._present(handle)
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        """Close, and give up any claim."""
        if self._claims.get(id(dev_handle.device)) is dev_handle:
            del self._claims[id(dev_handle.device)]

    def get_configuration(self, dev_handle: _Handle) -> int:
        """The one configuration is always set."""
        self._present(dev_handle)
        return CONFIGURATION

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Do nothing: it is set."""
        self._present(dev_handle)

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Take the interface; refused where another handle has it."""
        self._present(dev_handle)
        if self._claims.setdefault(id(dev_handle.device), dev_handle) is not dev_handle:
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Give the interface up."""
        self.close_device(dev_handle)

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """No kernel driver ever sees these devices."""
        return False

    def reset_device(self, dev_handle: _Handle) -> None:
        """Port reset; the devices here keep their state."""
        self._present(dev_handle)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """Clear the stall of a bulk pipe."""
        self._present(dev_handle)
        self._halted.discard((id(dev_handle.device), ep))

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:
        """Host to device."""
        self._present(dev_handle)
        with self._pipe(dev_handle, ep):
            dev_handle.device.host_sends(ep, bytes(data))
        return len(data)

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """Device to host; waits in the bus's time."""
        self._present(dev_handle)
        with self._pipe(dev_handle, ep):
            data = dev_handle.device.host_reads(ep, len(buff))
            if data is None:
                due = dev_handle.device.ready_s(ep)
                wait = timeout / 1000 if due is None else max(due - self._clock.now(), 0.0)
                self._clock.sleep(min(wait, timeout / 1000))
                data = dev_handle.device.host_reads(ep, len(buff))
        if data is None:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        buff[: len(data)] = array.array("B", data)
        return len(data)

    def intr_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:
        """Host to device, interrupt pipe."""
        return self.bulk_write(dev_handle, ep, intf, data, timeout)

    def intr_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """Device to host, interrupt pipe."""
        return self.bulk_read(dev_handle, ep, intf, buff, timeout)

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,
    ) -> int:
        """Standard request for strings, or whatever the device understands."""
        self._present(dev_handle)
        to_host = bool(bmRequestType & 0x80)
        if to_host and bRequest == GET_DESCRIPTOR and wValue >> 8 == STRING_DESCRIPTOR:
            answer = self._string(dev_handle.device, wValue & 0xFF)
        else:
            sent = b"" if to_host else bytes(data)
            try:
                answer = dev_handle.device.control(bmRequestType, bRequest, wValue, wIndex, sent)
            except UsbStallError:
                raise usb.core.USBError("Pipe error", -9, errno.EPIPE) from None
            except UsbGoneError:
                raise self._replugged(dev_handle.device) from None
            except UsbSilentError:
                self._clock.sleep(timeout / 1000)
                raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT) from None
        if not to_host:
            return len(data)
        answer = answer[: len(data)]
        data[: len(answer)] = array.array("B", answer)
        return len(answer)

    def _string(self, device: UsbFunction, index: int) -> bytes:
        text = device.strings[index - 1].encode("utf-16-le") if index else LANGUAGE_EN_US.to_bytes(2, "little")
        return bytes([len(text) + 2, STRING_DESCRIPTOR]) + text

    @contextmanager
    def _pipe(self, handle: _Handle, endpoint: int) -> Iterator[None]:
        pipe = (id(handle.device), endpoint)
        if pipe not in self._halted:
            try:
                yield
                return
            except UsbStallError:
                self._halted.add(pipe)
            except UsbGoneError:
                raise self._replugged(handle.device) from None
        raise usb.core.USBError("Pipe error", -9, errno.EPIPE)

    def _present(self, handle: _Handle) -> None:
        if handle.device not in self._devices or handle.visit != self._visits[id(handle.device)]:
            raise _no_such_device()

    def _replugged(self, device: UsbFunction) -> usb.core.USBError:
        self.unplug(device)
        self.plug_in(device)
        return _no_such_device()


def _no_such_device() -> usb.core.USBError:
    return usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
