"""``bench`` and ``python -m benchmarks``: what they run and what they write; the figures are not judged here."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

import benchmarks.__main__ as runner
from benchmarks import photographs
from tests.api.scenes import flat_set


@pytest.fixture
def quick(monkeypatch):
    """One benchmark that takes no time."""
    fake = SimpleNamespace(run=lambda: {"seconds": 0.5, "ratio": 3.0})
    monkeypatch.setattr(runner, "own_benchmarks", lambda: ["quick"])
    monkeypatch.setattr(runner, "import_module", lambda name: {"benchmarks.quick": fake}[name])


def test_every_benchmark_has_run():
    names = runner.own_benchmarks()
    assert "fit" in names
    assert "__main__" not in names


def test_figures_and_page_are_written(quick, tmp_path):
    found = runner.bench(tmp_path / "out", data=tmp_path / "none")
    assert found["benchmarks"] == {"quick": {"seconds": 0.5, "ratio": 3.0}}
    assert "not on this machine" in found["left_out"]
    assert json.loads((tmp_path / "out" / "bench.json").read_text())["benchmarks"] == found["benchmarks"]
    assert "## quick" in (tmp_path / "out" / "bench.md").read_text()


def test_only_what_a_run_wrote_is_replaced(quick, refused, tmp_path):
    for _ in range(2):
        runner.bench(tmp_path / "out", data=tmp_path / "none")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    assert "not empty" in refused("bench", "--out", tmp_path / "mine")


def test_photographs_become_rows_and_pages(quick, monkeypatch, tmp_path):
    (tmp_path / "data").mkdir()
    flat_set(tmp_path / "data" / "board")
    monkeypatch.setattr(photographs, "REGISTRY", {"lambert": "", "apparent-brdf": ""})
    monkeypatch.setattr(photographs, "SETS", (photographs.Photographs("board", "board", plain_psnr=30.0),))
    found = runner.bench(tmp_path / "out", data=tmp_path / "data", only="photographs")
    assert [(row["set"], row["model"]) for row in found["photographs"]] == [
        ("board", "lambert"),
        ("board", "apparent-brdf"),
    ]
    assert "| board | lambert |" in (tmp_path / "out" / "bench.md").read_text()
    assert (tmp_path / "out" / "board.html").is_file()


def test_bench_needs_the_projects_folder(refused, monkeypatch, tmp_path):
    from api.verbs import benchmarking

    monkeypatch.setattr(benchmarking, "__file__", str(tmp_path / "a" / "b" / "c.py"))
    assert "no such folder" in refused("bench", "--out", tmp_path / "out")


def test_bench_runs_the_projects_benchmarks(run, quick, monkeypatch, tmp_path):
    monkeypatch.setattr(photographs, "DATA", tmp_path / "none")
    outcome = run("bench", "--out", tmp_path / "out", "--json")
    assert outcome.code == 0, outcome
    assert outcome.json["benchmarks"]["quick"]["ratio"] == 3.0
