"""One USB device held by one program at a time, by plain pyusb: found by what it is, claimed, and asked.

Whatever libusb raises becomes a `UsbError` that names the device, says what was tried and what to do next. Waiting
here is waiting for the wire.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import usb.core
import usb.util

from stage.errors import DeviceError

T = TypeVar("T")

_ADVICE = {
    errno.ENODEV: "it was unplugged or lost power; check cable and power, then try again",
    errno.ETIMEDOUT: "it stopped answering; check its power, and plug it in again if that does not help",
    errno.EBUSY: "it is in use by another program; close that one first",
    errno.EACCES: "permission denied; add a udev rule for it or your user to the group 'plugdev', and plug it in again",
    errno.EPIPE: "it refused the transfer; try again, and plug it in again if that does not help",
}
_HOPELESS = (errno.ENODEV, errno.EBUSY, errno.EACCES)


class UsbError(DeviceError):
    """A transfer failed.

    Attributes
    ----------
    number : int
        The operating system's `errno`, 0 where libusb gives none.
    """

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.number = number

    @property
    def may_pass(self) -> bool:
        """Whether the same transfer may well succeed if it is tried again at once."""
        return self.number not in _HOPELESS


@dataclass(frozen=True)
class Wanted:
    """Which USB device is looked for; None matches any.

    Attributes
    ----------
    device : str
        What errors call it.
    field : str
        Part of the rig that tells it from others, for errors.
    vendor_id, product_id : int or None
        USB ids.
    serial : str or None
        Serial number.
    maker, product : str or None
        Strings that the device gives, where its ids are shared with other makes.
    interface : tuple of int
        Class, subclass and protocol of one of its interfaces, or the first of these.
    where_none : str
        What to do where none is found.
    """

    device: str
    field: str
    vendor_id: int | None = None
    product_id: int | None = None
    serial: str | None = None
    maker: str | None = None
    product: str | None = None
    interface: tuple[int, ...] = ()
    where_none: str = "check cable and power (lsusb lists what is plugged in)"

    @property
    def name(self) -> str:
        """How errors call it: what it is, which one, and where it is plugged in."""
        return f"{self.device}{f' {self.serial}' if self.serial else ''} over USB"


def find_device(wanted: Wanted, backend: Any = None, name: str = "") -> Any:
    """Find the one `usb.core.Device` that is wanted.

    Parameters
    ----------
    wanted : Wanted
        What it must be.
    backend : usb.backend.IBackend, optional
        Where pyusb finds devices; the system's libusb where none is given.
    name : str, optional
        What errors call it, where more is known of it than is wanted.

    Raises
    ------
    DeviceError
        Where there is none, there are several, none may be asked what it is, or libusb is missing.
    """
    name = name or wanted.name
    ids = {"idVendor": wanted.vendor_id, "idProduct": wanted.product_id}
    given = {key: value for key, value in ids.items() if value is not None}
    try:
        devices = list(usb.core.find(find_all=True, backend=backend, custom_match=_has(wanted.interface), **given))
    except usb.core.NoBackendError as error:
        raise DeviceError(f"{name}: libusb is missing; install the package libusb-1.0-0") from error
    except usb.core.USBError as error:
        raise _failure(name, "looking for it", error) from error
    refusals: list[Any] = []
    found = [device for device in devices if _says(device, wanted, refusals)]
    if len(found) > 1:
        which = ", ".join(f"{d.idVendor:04x}:{d.idProduct:04x} serial {_serial(d)}" for d in found)
        raise DeviceError(f"{name}: {len(found)} found ({which}); say which one by {wanted.field}.serial in the rig")
    if found:
        return found[0]
    if refusals:
        raise _failure(name, "asking what it is", refusals[0]) from refusals[0]
    raise DeviceError(f"{name}: none found; {wanted.where_none}")


class UsbInterface:
    """One interface of a USB device, claimed for this program alone.

    Parameters
    ----------
    device : usb.core.Device
        As `find_device` gives it.
    name : str
        What errors call it.
    kind : tuple of int
        Class, subclass and protocol of the interface, or the first of these; the first interface where empty.
    advice : mapping of int to str, optional
        What to do next, by the `errno` of a failure, where the device needs other words than most.
    """

    def __init__(
        self, device: Any, name: str, kind: tuple[int, ...] = (), advice: Mapping[int, str] | None = None
    ) -> None:
        self.name = name
        self._advice = advice
        self._device, self._kind = device, kind
        self._descriptor: Any = None

    @property
    def number(self) -> int:
        """Of the interface, as class requests to it want it."""
        return int(self._descriptor.bInterfaceNumber)

    def open(self) -> None:
        """Claim the interface, from the system's own driver too where it has one for the device."""
        self._guard("claiming it", self._claim)

    def close(self) -> None:
        """Release the interface; never raises."""
        with suppress(usb.core.USBError):  # a device that is gone already is what was wanted
            usb.util.dispose_resources(self._device)

    def endpoint(self, direction: int, kind: int = usb.util.ENDPOINT_TYPE_BULK) -> Any:
        """The endpoint of `usb.util.ENDPOINT_IN` or `usb.util.ENDPOINT_OUT`; None where there is none."""
        return usb.util.find_descriptor(
            self._descriptor,
            custom_match=lambda e: (
                usb.util.endpoint_direction(e.bEndpointAddress) == direction
                and usb.util.endpoint_type(e.bmAttributes) == kind
            ),
        )

    def send(self, what: str, endpoint: Any, data: bytes, timeout_s: float) -> None:
        """Write to an endpoint; `what` says in errors what it was for."""
        self._guard(what, lambda: endpoint.write(data, _ms(timeout_s)))

    def receive(self, what: str, endpoint: Any, size: int, timeout_s: float) -> bytes:
        """One transfer of up to `size` bytes, which must be a multiple of the endpoint's packet size."""
        return bytes(self._guard(what, lambda: endpoint.read(size, _ms(timeout_s))))

    def ask(self, what: str, kind: int, request: int, value: int, index: int, size: int, timeout_s: float) -> bytes:
        """Control request with up to `size` bytes of answer; `kind` is bmRequestType."""
        transfer = self._device.ctrl_transfer
        return bytes(self._guard(what, lambda: transfer(kind, request, value, index, size, _ms(timeout_s))))

    def tell(self, what: str, kind: int, request: int, value: int, index: int, data: bytes, timeout_s: float) -> None:
        """Control request that brings `data` to the device; `kind` is bmRequestType."""
        self._guard(what, lambda: self._device.ctrl_transfer(kind, request, value, index, data, _ms(timeout_s)))

    def clear_halt(self, endpoint: Any) -> None:
        """End the stall of an endpoint."""
        self._guard("clearing a stall", lambda: self._device.clear_halt(endpoint.bEndpointAddress))

    def _claim(self) -> None:
        try:
            configuration = self._device.get_active_configuration()
        except usb.core.USBError:
            self._device.set_configuration()
            configuration = self._device.get_active_configuration()
        self._descriptor = next(i for i in configuration if _is(i, self._kind))
        with suppress(NotImplementedError):  # not every system has kernel drivers to detach
            if self._device.is_kernel_driver_active(self.number):
                self._device.detach_kernel_driver(self.number)
        usb.util.claim_interface(self._device, self.number)

    def _guard(self, what: str, act: Callable[[], T]) -> T:
        try:
            return act()
        except usb.core.USBError as error:
            raise _failure(self.name, what, error, self._advice) from error


def _failure(name: str, what: str, error: Any, advice: Mapping[int, str] | None = None) -> UsbError:
    number = error.errno or 0
    next_step = (advice or _ADVICE).get(number, "check the cable, then try again")
    return UsbError(f"{name}: {what} failed: {error}; {next_step}", number)


def _is(interface: Any, kind: tuple[int, ...]) -> bool:
    own = (interface.bInterfaceClass, interface.bInterfaceSubClass, interface.bInterfaceProtocol)
    return own[: len(kind)] == kind


def _has(kind: tuple[int, ...]) -> Callable[[Any], bool]:
    def has_it(device: Any) -> bool:
        try:
            return any(_is(interface, kind) for configuration in device for interface in configuration)
        except usb.core.USBError:
            return False  # unconfigured, or vanishing just now

    return has_it


def _says(device: Any, wanted: Wanted, refusals: list[Any]) -> bool:
    wishes = {"manufacturer": wanted.maker, "product": wanted.product, "serial_number": wanted.serial}
    asked = {key: wish for key, wish in wishes.items() if wish is not None}
    if not asked:
        return True
    try:
        usb.util.get_langids(device)  # asked first, since pyusb hides why strings cannot be read
        return all(getattr(device, key) == wish for key, wish in asked.items())
    except (usb.core.USBError, ValueError) as error:
        if isinstance(error, usb.core.USBError):
            refusals.append(error)
        return False


def _serial(device: Any) -> str:
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):
        return "unknown"


def _ms(seconds: float) -> int:
    return max(1, math.ceil(seconds * 1000))
