"""libgphoto2's side of a camera; runs in a `drivers.worker.Worker`, because some of its calls never return.

References
----------
libgphoto2 API: gphoto2-camera.h, gphoto2-filesys.h; python-gphoto2 2.6.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from drivers.extras import require
from stage.errors import DeviceError, InputError

P = ParamSpec("P")
T = TypeVar("T")
NETWORK_MODEL = "PTP/IP Camera"
SHUTTER_SPEED = ("shutterspeed", "shutterspeed2")
"""Names of the setting by make."""
CAPTURE_TARGET, MEMORY = "capturetarget", ("Internal RAM", "sdram")
"""The setting and its choices by make that spare the card."""
IDENTITY = {
    "maker": "manufacturer",
    "model": "cameramodel",
    "version": "deviceversion",
    "serial_number": "serialnumber",
}
BUSY_TIMEOUT_S, BUSY_PAUSE_S = 5.0, 0.2
EVENT_WAIT_S, EVENT_PAUSE_S = 0.02, 0.002
EVENT_GRACE_S = 1.0
"""Once one of the two events has come, the other may take so much longer."""
HEARD_KEPT = 3

_SECONDS = re.compile(r"(?P<whole>\d+(?:\.\d+)?)(?:/(?P<part>\d+(?:\.\d+)?))?\s*(?:s|\"|'')?")


def seconds_of(choice: str) -> float | None:
    """Exposure time of a shutter speed as makers write it ('1/50', '0.0200s', '2.5', '30"'); None for 'Bulb'."""
    match = _SECONDS.fullmatch(choice.strip())
    if match is None:
        return None
    part = float(match["part"] or 1)
    return float(match["whole"]) / part if part and float(match["whole"]) else None


class _NotSupportedError(DeviceError):
    """The camera's driver in libgphoto2 lacks a function."""


class _BusyError(DeviceError):
    """The camera asks for patience."""


class Session:
    """One camera, opened on being made.

    Parameters
    ----------
    name : str
        Device and port, for errors.
    port : str
        ``usb:``, ``usb:BUS,DEVICE`` or ``ptpip:HOST[:PORT]``.
    iso : int or None
        Sensitivity to set.
    trigger : bool
        Whether to release and then wait for events, where the camera's driver can; else by the one call that does both.
    """

    def __init__(self, name: str, port: str, iso: int | None, trigger: bool) -> None:
        self._gp: Any = require("gphoto2", "gphoto2")
        self._name = name
        self._heard: deque[str] = deque(maxlen=HEARD_KEPT)
        self._context = self._gp.Context()
        self._listening = self._context.set_error_func(self._hear, None)  # for as long as this is referenced
        self._camera = self._gp.Camera()
        self._do("looking for it", self._choose, port)
        self._do("opening it", self._camera.init, self._context)
        self._trigger = trigger
        self._known: set[str] = set()
        self._taken: list[str] = []
        settings = self._do("reading its settings", self._camera.get_config, self._context)
        self._shutter = next((key for key in SHUTTER_SPEED if _child(settings, key) is not None), "")
        if not self._shutter:
            raise DeviceError(f"{name}: libgphoto2 offers no shutter speed for it; set it to manual exposure")
        self.identity = {key: _text(settings, widget) for key, widget in IDENTITY.items()}
        self._prepare(settings, iso)

    def describe(self) -> tuple[dict[str, str], dict[str, float]]:
        """What the camera is, and its shutter speeds: as it writes them, and in seconds."""
        widget = self._do("reading its shutter speeds", self._camera.get_single_config, self._shutter, self._context)
        choices = {choice: seconds_of(choice) for choice in _choices(widget)}
        return self.identity, {choice: seconds for choice, seconds in choices.items() if seconds is not None}

    def set_shutter(self, choice: str) -> None:
        """Set one of the shutter speeds."""
        self._set(self._shutter, choice)

    def files(self) -> set[str]:
        """Paths of all files on the card."""
        found: set[str] = set()
        folders = ["/"]
        while folders:
            folder = folders.pop()
            names = _listed(self._do("listing its card", self._camera.folder_list_files, folder, self._context))
            found |= {_path(folder, name) for name in names}
            below = _listed(self._do("listing its card", self._camera.folder_list_folders, folder, self._context))
            folders += [_path(folder, name) for name in below]
        return found

    def release(self, known: set[str]) -> None:
        """Begin to expose, or expose where the camera's driver cannot but wait for the file; see `announced`.

        Files that are `known`, or that a busy camera announces before it takes the release, are not this picture's.
        """
        self._known, self._taken = set(known), []
        if self._trigger:
            try:
                self._patiently("trigger_capture", self._camera.trigger_capture, self._context)
            except _NotSupportedError:
                self._trigger = False
            else:
                return
        taken = self._patiently("capture", self._camera.capture, self._gp.GP_CAPTURE_IMAGE, self._context)
        first = _path(taken.folder, taken.name)
        others = self._announced(time.monotonic() + EVENT_WAIT_S, complete=True)
        self._taken = [path for path in (first, *others) if path not in self._known]

    def announced(self, timeout_s: float) -> list[str]:
        """Paths of the files of the latest release that are announced within so many seconds, if any."""
        return self._taken or self._announced(time.monotonic() + timeout_s)

    def download(self, path: str) -> bytes:
        """A file's bytes, copied while libgphoto2's buffer lives."""
        folder, _, name = path.rpartition("/")
        kind, file = self._gp.GP_FILE_TYPE_NORMAL, self._gp.CameraFile()
        self._do(f"downloading {path}", self._camera.file_get, folder or "/", name, kind, file, self._context)
        return bytes(memoryview(file.get_data_and_size()))

    def delete(self, path: str) -> bool:
        """Remove a file from the camera; False where it will not."""
        folder, _, name = path.rpartition("/")
        try:
            self._camera.file_delete(folder or "/", name, self._context)
        except self._gp.GPhoto2Error:
            return False
        return True

    def close(self) -> None:
        """End the camera's session."""
        self._camera.exit(self._context)

    def _hear(self, _context: Any, message: bytes | str, _data: Any = None) -> None:
        text = message.decode(errors="replace") if isinstance(message, bytes) else message
        self._heard.append(" ".join(text.split()))

    def _choose(self, port: str) -> None:
        wire, _, place = port.partition(":")
        if wire == "usb":
            found = self._gp.Camera.autodetect()
            cameras = [(found.get_name(i), found.get_value(i)) for i in range(found.count())]
            chosen = [(model, at) for model, at in cameras if (at == port if place else at.startswith("usb:"))]
            if not chosen:
                raise DeviceError(
                    f"{self._name}: none found; connect it, switch it on, and set it to PTP or PC control"
                )
            if len(chosen) > 1:
                which = ", ".join(f"{model} on {address}" for model, address in chosen)
                raise DeviceError(
                    f"{self._name}: {len(chosen)} found ({which}); name one in the rig's camera.device.port"
                )
            model, path = chosen[0]
        else:
            host, _, number = place.partition(":")
            model, path = NETWORK_MODEL, f"ptpip:{host}:{number}:{number}" if number else f"ptpip:{host}"
        ports, models = self._gp.PortInfoList(), self._gp.CameraAbilitiesList()
        ports.load()
        models.load()
        self._camera.set_port_info(ports[ports.lookup_path(path)])
        self._camera.set_abilities(models[models.lookup_model(model)])

    def _prepare(self, settings: Any, iso: int | None) -> None:
        target = _child(settings, CAPTURE_TARGET)
        memory = next((choice for choice in _choices(target) if choice in MEMORY), None) if target is not None else None
        if memory is not None:
            self._set(CAPTURE_TARGET, memory)
        if iso is not None:
            widget = _child(settings, "iso")
            offered = _choices(widget) if widget is not None else []
            if str(iso) not in offered:
                raise InputError(f"rig: camera.device.iso: the camera offers {', '.join(offered)}, got {iso}")
            self._set("iso", str(iso))

    def _set(self, key: str, value: str) -> None:
        def write() -> None:
            widget = self._camera.get_single_config(key, self._context)
            widget.set_value(value)
            self._camera.set_single_config(key, widget, self._context)

        self._patiently(f"setting {key} to {value}", write)

    def _announced(self, deadline: float, *, complete: bool = False) -> list[str]:
        paths: list[str] = []
        while (left := deadline - time.monotonic()) > 0 and not (paths and complete):
            wait_ms = max(1, round(min(left, EVENT_WAIT_S) * 1000))
            kind, told = self._do("waiting for an event", self._camera.wait_for_event, wait_ms, self._context)
            if kind == self._gp.GP_EVENT_TIMEOUT:  # it comes long before its time on some wires
                time.sleep(min(EVENT_PAUSE_S, left))
            elif kind == self._gp.GP_EVENT_FILE_ADDED and (path := _path(told.folder, told.name)) not in self._known:
                paths.append(path)
                deadline = min(deadline, time.monotonic() + EVENT_GRACE_S)
            elif kind == self._gp.GP_EVENT_CAPTURE_COMPLETE:
                complete = True
                deadline = min(deadline, time.monotonic() + EVENT_GRACE_S)
        return paths

    def _patiently(self, what: str, act: Callable[P, T], *values: P.args, **named: P.kwargs) -> T:
        deadline = time.monotonic() + BUSY_TIMEOUT_S
        while True:
            try:
                return self._do(what, act, *values, **named)
            except _BusyError:
                if time.monotonic() > deadline:
                    raise
            self._known |= set(self._announced(time.monotonic() + BUSY_PAUSE_S))

    def _do(self, what: str, act: Callable[P, T], *values: P.args, **named: P.kwargs) -> T:
        self._heard.clear()
        try:
            return act(*values, **named)
        except self._gp.GPhoto2Error as error:
            raise self._failure(what, error) from error

    def _failure(self, what: str, error: Any) -> DeviceError:
        heard = f" ({' / '.join(self._heard)})" if self._heard else ""
        story = f"{self._name}: {what} failed: {error}{heard}"
        if "Store Full" in heard:  # which is no error of its own in libgphoto2
            return DeviceError(f"{story}; its card is full: empty it")
        match error.code:
            case self._gp.GP_ERROR_NOT_SUPPORTED:
                return _NotSupportedError(f"{story}; use another driver")
            case self._gp.GP_ERROR_CAMERA_BUSY:
                return _BusyError(f"{story}; wait until it has written its pictures, then try again")
            case self._gp.GP_ERROR_IO_USB_CLAIM:
                return DeviceError(f"{story}; another program has it: close that one (a file manager, perhaps)")
            case self._gp.GP_ERROR_IO | self._gp.GP_ERROR_TIMEOUT:
                return DeviceError(f"{story}; check that it is awake and connected, then try again")
            case _:
                return DeviceError(f"{story}; check card, settings and cable, and whether another program has it")


def _path(folder: str, name: str) -> str:
    return f"{folder.rstrip('/')}/{name}"


def _listed(found: Any) -> list[str]:
    return [found.get_name(i) for i in range(found.count())]


def _child(settings: Any, key: str) -> Any:
    for i in range(settings.count_children()):
        child = settings.get_child(i)
        if child.get_name() == key:
            return child
        if (found := _child(child, key)) is not None:
            return found
    return None


def _choices(widget: Any) -> list[str]:
    return [widget.get_choice(i) for i in range(widget.count_choices())]


def _text(settings: Any, key: str) -> str:
    widget = _child(settings, key)
    return "" if widget is None else str(widget.get_value())
