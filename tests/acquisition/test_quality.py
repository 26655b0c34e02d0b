"""Faults with known answers: each is found as what it is, and nothing else is."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from acquisition.plan import Shot
from acquisition.quality import FrameStatistics, FrameView, Limits, QualityWatch, ReferenceDrift, frame_statistics
from acquisition.radiance import RawFrame
from acquisition.taken import TakenShot
from tests.acquisition.quality_scene import (
    BLACK,
    FULL,
    HEIGHT,
    READ_NOISE,
    WHITE,
    WIDTH,
    capture,
    dome,
    kinds,
    lit,
    photograph,
    radiance,
    reference,
    unlit,
)

PLACES = dome(40)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


@pytest.fixture
def watch(rng: np.random.Generator) -> QualityWatch:
    """Has seen an untouched capture, shots 100 to 139."""
    watch = QualityWatch()
    assert not any(capture(watch, rng, PLACES).values())
    return watch


def test_an_untouched_capture_has_no_findings_and_no_suspects(watch: QualityWatch) -> None:
    assert watch.suspects() == ()


def test_statistics_are_what_the_picture_was_made_of(rng: np.random.Generator) -> None:
    light = radiance(PLACES[3])
    frame = photograph(light, rng, exposure_s=0.02)
    found = frame_statistics(frame)
    signal = light * 0.02 * 50_000
    assert_allclose(found.mean, signal.mean() / (WHITE - BLACK), rtol=0.01)
    blocks = signal.reshape(8, HEIGHT // 8, 8, WIDTH // 8).mean((1, 3)).ravel()
    noise = np.sqrt((READ_NOISE**2 + signal.max()) / 3 / (HEIGHT * WIDTH / 64))
    assert_allclose(found.blocks, blocks, atol=6 * noise)
    assert found.saturated == (0, 0, 0)
    dark = frame_statistics(photograph(0.0, rng))
    assert dark.noise * (WHITE - BLACK) == pytest.approx(READ_NOISE / 3**0.5, rel=0.1)
    assert dark.sharpness is None
    assert dark.dark > 0.999


def test_statistics_are_small_and_survive_their_json(rng: np.random.Generator) -> None:
    found = frame_statistics(photograph(radiance(PLACES[0]), rng))
    text = json.dumps(found.to_json())
    assert len(text) < 1000
    assert FrameStatistics.from_record(json.loads(text)) == found


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (12, 14), (64, 43)])
def test_a_picture_of_any_size_has_statistics(size: tuple[int, int], rng: np.random.Generator) -> None:
    values = (600 + 50 * rng.random((*size, 3))).astype(np.float32)
    found = frame_statistics(RawFrame(values, values > WHITE, np.full(3, BLACK), WHITE, None))
    assert found.pixels == size[0] * size[1]
    expected = (values.mean((0, 1), dtype=float) - BLACK) / (WHITE - BLACK)
    np.testing.assert_allclose(found.mean, expected, rtol=1e-4)


def test_a_lamp_that_is_off_is_told_from_a_light_that_grazes(watch: QualityWatch, rng: np.random.Generator) -> None:
    assert kinds(watch, lit(120, PLACES[20], photograph(0.0, rng), sha256="again")) == ["light-off"]


def test_a_light_behind_the_object_is_no_lamp_that_is_off(rng: np.random.Generator) -> None:
    """The dark frames are told (nothing can be measured there), and not held against the lamp once it has shone."""
    watch = QualityWatch()
    below = [(x, y, -z) for x, y, z in dome(12)]
    capture(watch, rng, PLACES)
    found = []
    for k, p in enumerate(below):
        found.append(kinds(watch, lit(200 + k, p, photograph(0.0, rng))))
        known = lit(120, PLACES[20], photograph(radiance(PLACES[20]), rng), sha256=f"looked again {k}")
        assert not kinds(watch, known)
    assert found[-1] == ["dark"]
    assert all(kind != "light-off" for kind in found[-1])
    assert not [shot for shot, finding in watch.suspects() if finding.kind == "light-off"]


def test_the_first_frame_without_light_is_found_later(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    for k in range(2):
        kinds(watch, unlit(k, photograph(0.0, rng)))
    assert kinds(watch, lit(100, PLACES[0], photograph(0.0, rng))) == ["dark"]
    for k in range(1, 12):
        assert not kinds(watch, lit(100 + k, PLACES[k], photograph(radiance(PLACES[k]), rng)))
    assert [(shot, finding.kind) for shot, finding in watch.suspects()] == [(100, "light-off")]


def test_a_wrong_light_is_found_at_once(watch: QualityWatch, rng: np.random.Generator) -> None:
    judgement = watch.judge(lit(105, PLACES[5], photograph(radiance(PLACES[33]), rng), sha256="again"))
    (finding,) = judgement.findings
    assert finding.kind == "wrong-light"
    assert finding.retake
    assert finding.message.startswith("shot 105 (light, light 105, 0.1 s): ")


def test_a_dimmer_light_at_the_right_place_is_no_wrong_one(watch: QualityWatch, rng: np.random.Generator) -> None:
    """A lamp that drifts is the reference frames' business."""
    assert not kinds(watch, lit(105, PLACES[5], photograph(radiance(PLACES[5], 0.6), rng), sha256="again"))


def test_an_early_wrong_light_is_found_in_the_end_and_its_retake_settles_it(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    for k in range(2):
        kinds(watch, unlit(k, photograph(0.0, rng)))
    for k, place in enumerate(PLACES):
        seen = PLACES[30] if k == 1 else place
        assert not kinds(watch, lit(100 + k, place, photograph(radiance(seen), rng)))
    assert [(shot, finding.kind) for shot, finding in watch.suspects()] == [(101, "wrong-light")]
    assert not kinds(watch, lit(101, PLACES[1], photograph(radiance(PLACES[1]), rng), sha256="again"))
    assert watch.suspects() == ()


def test_two_lights_that_are_swapped_are_both_found(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    capture(watch, rng, PLACES)
    for k, other in ((8, 31), (31, 8)):
        kinds(watch, lit(100 + k, PLACES[k], photograph(radiance(PLACES[other]), rng), sha256=f"again {k}"))
    assert {shot for shot, _ in watch.suspects()} == {108, 131}


def test_with_few_neighbours_nothing_is_said(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    capture(watch, rng, PLACES[:5])
    assert not kinds(watch, lit(150, PLACES[30], photograph(radiance(PLACES[2]), rng)))
    assert watch.suspects() == ()


@pytest.mark.parametrize("along", [True, False])
def test_a_shake_is_found_whichever_way_it_goes(watch: QualityWatch, rng: np.random.Generator, along: bool) -> None:
    sharp = radiance(PLACES[20])
    smeared = cv2.blur(sharp, (9, 1) if along else (1, 9))
    assert kinds(watch, lit(120, PLACES[20], photograph(smeared, rng), sha256="again")) == ["blurred"]


def test_the_same_file_twice_is_a_duplicate(watch: QualityWatch, rng: np.random.Generator) -> None:
    frame = photograph(radiance(PLACES[20]), rng)
    assert not kinds(watch, lit(200, PLACES[20], frame, sha256="a"))
    same_file, same_pixels = (lit(201, PLACES[21], frame, sha256=digest) for digest in ("a", "another header"))
    for view in (same_file, same_pixels):
        (finding,) = watch.judge(view).findings
        assert finding.kind == "duplicate"
        assert "shot 200 (light, light 200, 0.1 s)" in finding.message


def test_frames_that_hold_no_noise_are_not_compared_by_their_pixels(rng: np.random.Generator) -> None:
    """Two pictures of nothing by a camera without noise are alike, and no duplicates."""
    black = photograph(0.0, rng)
    nothing = replace(black, values=np.full_like(black.values, BLACK))
    watch = QualityWatch()
    assert not kinds(watch, unlit(0, nothing))
    assert not kinds(watch, unlit(1, nothing))


def test_a_camera_that_replays_may_repeat_itself_but_not_for_another_light(rng: np.random.Generator) -> None:
    frame = photograph(radiance(PLACES[0]), rng)
    watch = QualityWatch(repeats_alike=True)
    first = FrameView(Shot(0, 0.1, candidates=(3,)), 0.1, frame, PLACES[0], FULL, "a")
    again = replace(first, shot=Shot(1, 0.1, candidates=(3,), repeat=1))
    other = replace(first, shot=Shot(2, 0.1, candidates=(4,)))
    assert not kinds(watch, first)
    assert not kinds(watch, again)
    assert kinds(watch, other) == ["duplicate"]


def test_a_bracket_is_judged_by_the_member_that_could_measure(rng: np.random.Generator) -> None:
    """Clipped in the longest and dark in the shortest exposure is what a bracket is for."""
    times = (0.0001, 0.1, 10.0)
    watch = QualityWatch(exposures_s=times)
    found = {}
    for k, exposure_s in enumerate(times):
        kinds(watch, unlit(k, photograph(0.0, rng, exposure_s=exposure_s), exposure_s=exposure_s))
        frame = photograph(radiance(PLACES[0], 0.5), rng, exposure_s=exposure_s)
        found[exposure_s] = kinds(watch, lit(10 + k, PLACES[0], frame, exposure_s=exposure_s))
    assert not any(found.values())
    too_bright = photograph(radiance(PLACES[1], 1e4), rng, exposure_s=times[0])
    assert kinds(watch, lit(20, PLACES[1], too_bright, exposure_s=times[0])) == ["saturated"]
    too_dark = photograph(0.0, rng, exposure_s=times[2])
    assert kinds(watch, lit(21, PLACES[1], too_dark, exposure_s=times[2])) == ["dark"]


def test_the_limit_of_clipped_pixels_is_the_callers(rng: np.random.Generator) -> None:
    frame = photograph(radiance(PLACES[0]), rng)
    clipped = frame.clipped.copy()
    clipped[: HEIGHT // 10] = True
    view = lit(0, PLACES[0], replace(frame, clipped=clipped))
    assert [f.kind for f in QualityWatch().judge(view).findings] == ["saturated"]
    assert not QualityWatch(Limits(saturated_share=0.2)).judge(view).findings


def test_drift_of_the_lamp_is_measured_with_its_uncertainty(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    for k in range(4):
        kinds(watch, unlit(k, photograph(0.0, rng)))
    levels = (1.0, 0.99, 0.97)
    for k, level in enumerate(levels):
        assert not kinds(watch, reference(10 + k, photograph(radiance(PLACES[0], level), rng), 60.0 * k))
    for one, level in zip(watch.reference.ratios, levels, strict=True):
        assert abs(one.ratio - level) < 5 * one.uncertainty
        assert one.uncertainty < 0.002
    assert watch.reference.drift() == watch.reference.ratios[-1]
    assert watch.reference.ratio_at(90.0) == pytest.approx(0.98, abs=0.002)
    assert watch.reference.ratio_at(1e6) == watch.reference.ratios[-1].ratio


def test_without_reference_frames_nothing_drifts() -> None:
    drift = ReferenceDrift()
    assert drift.drift() is None
    assert drift.ratio_at(5.0) == 1.0


def test_a_camera_that_was_moved_is_told_by_the_reference_frame(rng: np.random.Generator) -> None:
    watch, light = QualityWatch(), radiance(PLACES[0])
    assert not kinds(watch, reference(0, photograph(light, rng), 0.0))
    assert not kinds(watch, reference(1, photograph(light, rng), 1.0))
    moved = watch.judge(reference(2, photograph(np.roll(light, 3, axis=1), rng), 2.0))
    assert [finding.kind for finding in moved.findings] == ["moved"]
    said = re.search(r"lies (\S+) pixels", moved.findings[0].message)
    assert said is not None
    assert float(said[1]) == pytest.approx(3, abs=0.4)  # a window pulls towards 0


def test_what_has_not_moved_does_not_move_by_being_looked_at_often(rng: np.random.Generator) -> None:
    watch, light = QualityWatch(), radiance(PLACES[0])
    assert not any(kinds(watch, reference(k, photograph(light, rng), float(k))) for k in range(40))


def test_a_lamp_that_dies_does_not_excuse_itself(watch: QualityWatch, rng: np.random.Generator) -> None:
    """Frames that are doubted are no neighbours; a light that has lit the object before does so again, or is off."""
    others = sorted(range(40), key=lambda k: float(np.linalg.norm(np.subtract(PLACES[k], PLACES[20]))))[:3]
    found = [kinds(watch, lit(300 + k, PLACES[k], photograph(0.0, rng))) for k in others]
    assert found == [["light-off"]] * 3
    assert kinds(watch, lit(139, PLACES[39], photograph(0.0, rng), sha256="again")) == ["light-off"]


def test_a_reference_frame_without_light_is_found_and_does_not_count(rng: np.random.Generator) -> None:
    watch = QualityWatch()
    kinds(watch, unlit(0, photograph(0.0, rng)))
    kinds(watch, reference(1, photograph(radiance(PLACES[0]), rng), 0.0))
    assert "light-off" in kinds(watch, reference(2, photograph(0.0, rng), 1.0))
    assert len(watch.reference.ratios) == 1


def line(view: FrameView, statistics: FrameStatistics) -> TakenShot:
    shot = view.shot
    return TakenShot(
        shot=shot.index,
        kind=shot.kind,
        part=shot.part,
        candidates=shot.candidates,
        exposure_s=shot.exposure_s,
        exposed_s=shot.exposure_s,
        file=f"raw/{shot.name}.dng",
        sha256=view.sha256,
        size_bytes=1,
        width=1,
        height=1,
        commanded=None,
        measured=None,
        levels=(1.0,),
        position=view.position,
        intensity=view.intensity,
        started="2024-01-01T12:00:00+00:00",
        run=1,
        take=1,
        attempts=1,
        spans={"expose": (0.0, 1.0)},
        camera={},
        statistics=statistics.to_json(),
    )


def test_a_watch_restored_from_the_record_judges_as_the_one_that_saw_the_frames(rng: np.random.Generator) -> None:
    watch, lines, shots = QualityWatch(), [], {}
    views = [unlit(0, photograph(0.0, rng)), reference(1, photograph(radiance(PLACES[0]), rng), 0.0)]
    views += [lit(2 + k, p, photograph(radiance(PLACES[9] if k == 3 else p), rng)) for k, p in enumerate(PLACES)]
    for view in views:
        judgement = watch.judge(view)
        watch.remember(view, judgement)
        lines.append(TakenShot.model_validate_json(line(view, judgement.statistics).model_dump_json()))
        shots[view.shot.index] = view.shot
    restored = QualityWatch()
    restored.restore(lines, [shots[k] for k in sorted(shots)])
    assert (
        [(s, f.kind) for s, f in restored.suspects()]
        == [(s, f.kind) for s, f in watch.suspects()]
        == [(5, "wrong-light")]
    )
    new = lit(11, PLACES[9], photograph(radiance(PLACES[30]), rng), sha256="again")
    assert [f.kind for f in restored.judge(new).findings] == ["wrong-light"]
    assert [f.kind for f in restored.judge(replace(new, sha256="file 2")).findings] == ["duplicate"]
    assert ReferenceDrift.of(lines).ratios[0].ratio == pytest.approx(1.0)
