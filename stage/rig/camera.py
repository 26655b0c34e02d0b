"""The camera that stands still: its calibration, and the device behind it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from stage.camera import Camera
from stage.rig.parts import NonNegative, RigPart, Row3, Row4


class CameraDevice(RigPart):
    """What all cameras have in common.

    Attributes
    ----------
    exposure_s : float
        Exposure time of a frame where a plan names none.
    transfer : str
        How the stored values of pictures relate to radiance (``linear``, ``srgb`` or ``gamma:2.2``); RAW files, which
        are linear, do not ask for it.
    """

    exposure_s: PositiveFloat
    transfer: str = Field(default="srgb", pattern=r"^(linear|srgb|gamma:\d+(\.\d+)?)$")


class StillTiming(RigPart):
    """How long a still camera takes for what it does; a simulated one takes just that.

    Attributes
    ----------
    readout_s : float
        From the end of an exposure to the file on the card.
    download_s : float
        For a file to come over the wire.
    recovery_s : float
        For so long after a file is on the card the next release is refused.
    """

    readout_s: NonNegative = 0.05
    download_s: NonNegative = 0.0
    recovery_s: NonNegative = 0.0


class StillCameraDevice(CameraDevice):
    """What all still cameras have in common.

    Attributes
    ----------
    iso : int or None
        Sensitivity to set on opening; None leaves the camera's own setting.
    shutter_lag_s : float or None
        Longest time from a release to the opening of the shutter. Where it is given, the light moves on once that and
        the exposure are over, while the camera reads out; where not, once the camera announces the file.
    timing : StillTiming
        How slow the simulated camera is; a real one is as slow as it is.
    """

    iso: PositiveInt | None = None
    shutter_lag_s: NonNegative | None = None
    timing: StillTiming = StillTiming()


class PtpUsb(StillCameraDevice):
    """A still camera that speaks PTP over USB.

    Attributes
    ----------
    port : str
        ``usb``, or ``sim:`` for a simulated one.
    vendor_id, product_id : int or None
        USB ids; None takes any still-image device.
    serial : str or None
        USB serial number, where several cameras of one make are plugged in.
    """

    driver: Literal["ptp-usb"]
    port: str = "usb"
    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    product_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    serial: str | None = None


class PtpIp(StillCameraDevice):
    """A still camera that speaks PTP over a network; `port` is ``HOST`` or ``HOST:PORT``."""

    driver: Literal["ptp-ip"]
    port: str = Field(min_length=1)


class Gphoto2(StillCameraDevice):
    """A still camera that libgphoto2 knows; `port` is ``usb:``, ``usb:BUS,DEVICE`` or ``ptpip:HOST[:PORT]``."""

    driver: Literal["gphoto2"]
    port: str = "usb:"


class OpenCvStream(CameraDevice):
    """A video camera or stream that OpenCV opens.

    Attributes
    ----------
    port : str
        Number or path of a UVC device, or the address of an RTSP or MJPEG stream.
    frames_per_shot : int
        Frames averaged to one picture.
    read_timeout_s : float
        A frame that takes longer does not come.
    latency_s : float
        From the end of an exposure to the arrival of its frame, beyond the time between two frames: what the camera
        takes to encode and the network to carry it.
    """

    driver: Literal["opencv"]
    port: str = Field(min_length=1)
    frames_per_shot: PositiveInt = 1
    read_timeout_s: PositiveFloat = 2.0
    latency_s: NonNegative = 0.0


class Replay(CameraDevice):
    """No camera: the photographs of a dataset, each shown while the light is where it was taken.

    Attributes
    ----------
    folder : str
        Dataset, or any folder that ``import`` reads.
    within_deg : float
        How far the light may be from where a photograph was taken.
    """

    driver: Literal["replay"]
    folder: str = Field(min_length=1)
    within_deg: PositiveFloat = 1.0


AnyCamera = Annotated[PtpUsb | PtpIp | Gphoto2 | OpenCvStream | Replay, Field(discriminator="driver")]


class CameraPlace(RigPart):
    """The camera: its calibration (see `stage.camera.Camera`) and the device behind it.

    Width, height and K are those of the pictures, which of RAW files have one pixel per 2 x 2 photosites of the sensor.
    `radiance_per_dn_s` is the radiance per channel, in units of the lamp's intensity per square metre, that raises a
    RAW number by one in one second; None where that was not measured, and pictures are then relative.
    """

    width: PositiveInt
    height: PositiveInt
    K: tuple[Row3, Row3, Row3]
    world_to_camera: tuple[Row4, Row4, Row4, Row4]
    distortion: tuple[float, ...] = ()
    radiance_per_dn_s: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None = None
    device: AnyCamera

    @model_validator(mode="after")
    def _calibrated(self) -> Self:
        self.calibration()
        return self

    def calibration(self) -> Camera:
        """The pinhole camera that projects the stage into its pictures."""
        return Camera.create(self.width, self.height, self.K, self.world_to_camera, self.distortion)
