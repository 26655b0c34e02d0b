"""The light moves on while a still camera reads out and its file comes over the wire, whatever goes wrong with that."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import pytest

from drivers.ptp_camera import PtpCamera
from simulators.clock import RunningClock, VirtualClock
from simulators.stage_sim import SimulatedStage
from stage.devices import CapturedFrame, Exposure
from stage.errors import DeviceError, InputError
from stage.rig import Rig
from tests.bench import PlainWorld, make_rig, rig_mapping
from tests.drivers.still_bench import WIRES, StillBench

pytestmark = pytest.mark.system

T = TypeVar("T")
LAG_S, READOUT_S, DOWNLOAD_S = 0.06, 0.4, 1.0


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture(params=WIRES)
def bench(request: pytest.FixtureRequest, clock: VirtualClock) -> Iterator[StillBench]:
    threads = threading.active_count()
    with StillBench(request.param, clock, readout_s=READOUT_S, download_s=DOWNLOAD_S) as stage:
        yield stage
    assert threading.active_count() == threads


@pytest.fixture(params=[None, LAG_S], ids=["announced", "lag"])
def camera(request: pytest.FixtureRequest, bench: StillBench) -> Iterator[PtpCamera]:
    """A camera whose shutter lag is known, and one where it is not."""
    patience = {"answer_timeout_s": 5.0} if bench.wire == "usb" else {}  # a network's is real time
    with bench.photographer(shutter_lag_s=request.param, **patience) as opened:
        yield opened


def elsewhere(act: Callable[[], T]) -> T:
    """Act in another thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(act).result(20)


def fetched(camera: PtpCamera, exposure: Exposure) -> CapturedFrame:
    return elsewhere(lambda: camera.download(exposure))


def assert_works(bench: StillBench, camera: PtpCamera) -> None:
    assert fetched(camera, camera.expose(0.1)).data == bench.world.photographs[-1]


def test_each_step_takes_its_time_and_not_the_others(bench: StillBench, camera: PtpCamera) -> None:
    known = camera._shutter_lag_s is not None
    for _ in range(3):
        begun_s = bench.clock.now()
        exposure = camera.expose(0.1)
        free_s = bench.clock.now() - begun_s
        frame = fetched(camera, exposure)
        assert exposure.started_s == frame.started_s == pytest.approx(begun_s, abs=0.002)
        assert exposure.expose_s == frame.expose_s == pytest.approx(free_s, abs=0.002)
        least_s, all_s = 0.1 + (LAG_S if known else READOUT_S), 0.1 + READOUT_S + DOWNLOAD_S
        assert frame.expose_s >= least_s - 1e-9
        assert bench.clock.now() - begun_s >= all_s - 1e-9
        if bench.wire == "usb":  # a simulated network's time passes in steps
            assert frame.expose_s == pytest.approx(least_s)
            assert frame.expose_s + frame.download_s == pytest.approx(all_s, abs=0.01)
        assert frame.data == bench.world.photographs[-1]
    assert bench.card() == 0


@pytest.mark.parametrize("fault", ["repeated-frame", "wrong-exposure", "lost-picture"])
def test_a_picture_that_is_not_the_one_is_told_and_not_taken_again(
    bench: StillBench, camera: PtpCamera, fault: str
) -> None:
    assert_works(bench, camera)
    bench.camera.board.strike(fault)
    with pytest.raises(DeviceError, match=r"INITIATE_CAPTURE"):
        fetched(camera, camera.expose(0.1))
    assert len(bench.world.photographs) == 2 - (fault == "lost-picture")
    assert_works(bench, camera)


@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_camera_that_falls_asleep_in_a_download_is_woken_and_its_file_found(
    bench: StillBench, camera: PtpCamera, after: int
) -> None:
    exposure = camera.expose(0.1)
    # in turn: when its file is asked about, downloaded, and deleted
    bench.camera.board.strike_at(bench.camera.board.messages + after, "asleep")
    assert fetched(camera, exposure).data == bench.world.photographs[0]
    assert_works(bench, camera)
    assert len(bench.world.photographs) == 2


def test_a_torn_or_stalled_download_is_repeated_and_given_up_for_the_next_exposure(
    bench: StillBench, camera: PtpCamera
) -> None:
    for fault, too_often in (("torn-download", 3), ("stalled-download", 2)):
        bench.camera.board.strike(fault)
        assert_works(bench, camera)
        exposure = camera.expose(0.1)
        bench.camera.board.strike(fault, times=too_often)
        with pytest.raises(DeviceError, match="GET_OBJECT"):
            fetched(camera, exposure)
        taken = len(bench.world.photographs)
        assert_works(bench, camera)
        assert len(bench.world.photographs) == taken + 1
    assert bench.card() == 2  # what was given up, and is known


@pytest.mark.parametrize("exposure_s", [0.1, 5.0])
def test_a_picture_that_nobody_fetched_is_not_taken_for_the_next(
    bench: StillBench, camera: PtpCamera, exposure_s: float
) -> None:
    for _ in range(2):
        camera.expose(exposure_s)
    assert_works(bench, camera)
    assert_works(bench, camera)
    assert len(bench.world.photographs) == 4
    assert bench.card() == 2


def test_unplugged_before_a_download_it_is_one_sentence_and_the_next_picture_is_the_right_one(
    bench: StillBench, camera: PtpCamera
) -> None:
    exposure = camera.expose(0.1)
    bench.unplug()
    with pytest.raises(DeviceError, match=r"camera Simulated Camera .*; .*check"):
        fetched(camera, exposure)
    bench.plug_in()
    assert_works(bench, camera)
    assert len(bench.world.photographs) == 2


def test_an_exposure_from_before_it_was_closed_is_found_or_refused(bench: StillBench, camera: PtpCamera) -> None:
    exposure = camera.expose(0.1)
    camera.close()
    camera.open()
    assert fetched(camera, exposure).data == bench.world.photographs[0]
    with pytest.raises(DeviceError, match="fetched or given up"):
        fetched(camera, exposure)


def test_side_by_side_a_move_and_a_download_take_as_long_as_the_longer() -> None:
    clock = VirtualClock()
    with (
        StillBench("usb", clock, readout_s=READOUT_S, download_s=DOWNLOAD_S) as bench,
        bench.photographer(shutter_lag_s=LAG_S) as camera,
        ThreadPoolExecutor(1) as pool,
        clock.at_work(),
    ):

        def fetch(exposure: Exposure, work: AbstractContextManager[None]) -> bytes:
            with work:
                return camera.download(exposure).data

        begun_s = clock.now()
        for _ in range(5):
            exposure = camera.expose(0.1)
            download = pool.submit(fetch, exposure, clock.at_work())
            for _ in range(30):
                clock.sleep(0.02)  # a move of 0.6 s, watched
            while not download.done():
                clock.sleep(0.02)
            assert download.result() == bench.world.photographs[-1]
        assert clock.now() - begun_s == pytest.approx(5 * (0.1 + READOUT_S + DOWNLOAD_S), rel=0.03)


def slow_rig(driver: str, **timing: float) -> Rig:
    device: dict[str, Any] = {"driver": driver, "exposure_s": 0.1, "shutter_lag_s": LAG_S, "timing": timing}
    return make_rig(camera=rig_mapping()["camera"] | {"device": device | {"port": "sim:"}})


def test_a_rig_says_how_slow_its_simulated_camera_is() -> None:
    clock = VirtualClock()
    rig = slow_rig("ptp-usb", readout_s=0.3, download_s=1.0, recovery_s=2.0)
    with (
        SimulatedStage(PlainWorld(clock), rig, clock) as stage,
        PtpCamera.over_usb(stage.rig.camera.device, clock=clock, backend=stage.usb) as camera,
    ):
        first, second = camera.capture(0.1), camera.capture(0.1)
        assert first.expose_s == pytest.approx(0.1 + LAG_S)
        assert first.expose_s + first.download_s == pytest.approx(0.1 + 0.3 + 1.0, abs=0.01)
        assert second.started_s - first.started_s >= 0.1 + 0.3 + 2.0  # busy until then


def test_a_camera_on_a_simulated_network_is_as_slow_in_real_time() -> None:
    clock = RunningClock()
    try:
        rig = slow_rig("ptp-ip", readout_s=0.2, download_s=0.4)
        with (
            SimulatedStage(PlainWorld(clock), rig, clock) as stage,
            PtpCamera.over_ip(stage.rig.camera.device, clock=clock) as camera,
        ):
            frame = camera.capture(0.1)
            assert 0.1 + LAG_S <= frame.expose_s < 0.1 + 0.2
            assert 0.7 <= frame.expose_s + frame.download_s < 1.5
    finally:
        clock.close()


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("shutter_lag_s", -0.1, r"shutter_lag_s"),
        ("shutter_lag_s", float("inf"), r"shutter_lag_s"),
        ("timing", {"readout_s": -1}, r"timing\.readout_s"),
        ("timing", {"speed": 1}, r"timing\.speed"),
    ],
)
def test_timings_that_are_none_are_refused(field: str, value: object, words: str) -> None:
    device = {"driver": "ptp-ip", "port": "sim:", "exposure_s": 0.1, field: value}
    with pytest.raises(InputError, match=rf"rig\.yaml: camera\.device\..*{words}"):
        make_rig(camera=rig_mapping()["camera"] | {"device": device})
