"""Output appears wholly or not at all, and nothing stays beside its place."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from acquisition.dataset import staged_file, staged_folder, write_dataset, write_exr
from stage.errors import InputError
from stage.lights import Light


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_appears_when_the_block_ends(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with staged_folder(out) as folder:
        (folder / "sub").mkdir()
        (folder / "sub/a").write_text("a")
        assert folder.parent == tmp_path
        assert folder.name.startswith(".")
        assert not out.exists()
    assert names(tmp_path) == ["out"]
    assert (out / "sub/a").read_text() == "a"
    assert out.stat().st_mode & 0o777 == 0o777 & ~current_umask()


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_an_empty_folder_is_filled_and_a_full_one_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with staged_folder(out) as folder:
        (folder / "a").write_text("a")
    with pytest.raises(InputError, match="out: output: the folder exists and is not empty"), staged_folder(out):
        pass
    with staged_folder(str(out), replace=True) as folder:
        (folder / "b").write_text("b")
    assert names(tmp_path) == ["out"]
    assert names(out) == ["b"]


@pytest.mark.parametrize("fault", [ValueError, KeyboardInterrupt, SystemExit, GeneratorExit])
@pytest.mark.parametrize("existing", [False, True])
def test_nothing_is_left_when_the_block_fails(tmp_path: Path, fault: type[BaseException], existing: bool) -> None:
    out, file = tmp_path / "out", tmp_path / "file"
    if existing:
        out.mkdir()
        (out / "old").write_text("old")
        file.write_text("old")
    before = names(tmp_path)

    def fill_folder() -> None:
        with staged_folder(out, replace=True) as folder:
            (folder / "deep").mkdir()
            (folder / "deep/half").write_text("half")
            raise fault

    def fill_file() -> None:
        with staged_file(file) as temporary:
            temporary.write_text("half")
            raise fault

    for fill in (fill_folder, fill_file):
        with pytest.raises(fault):
            fill()
    assert names(tmp_path) == before
    if existing:
        assert names(out) == ["old"]
        assert file.read_text() == "old"


def test_a_file_is_replaced_in_one_step(tmp_path: Path) -> None:
    out = tmp_path / "a.exr"
    for value in (1.0, 2.0):
        with staged_file(out) as temporary:
            assert temporary.suffix == ".exr"
            write_exr(temporary, np.full((2, 2), value))
    assert names(tmp_path) == ["a.exr"]


def test_a_link_keeps_pointing_and_its_target_changes(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with staged_folder(tmp_path / "link") as folder:
        (folder / "a").write_text("a")
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "real") == ["a"]
    (tmp_path / "real/file").write_text("old")
    (tmp_path / "shortcut").symlink_to(tmp_path / "real/file")
    with staged_file(tmp_path / "shortcut") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "shortcut").is_symlink()
    assert (tmp_path / "real/file").read_text() == "new"


def test_a_place_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for stage in (staged_folder, staged_file):
        with (
            pytest.raises(InputError, match=r"b: output: the folder .*none does not exist"),
            stage(tmp_path / "none/b"),
        ):
            pass
        with pytest.raises(InputError, match="does not exist"), stage(tmp_path / "file/b"):
            pass
        with pytest.raises(InputError, match="output: cannot be written"), stage(tmp_path / ("n" * 300)) as temporary:
            temporary.mkdir(exist_ok=True) if stage is staged_folder else temporary.touch()
        with pytest.raises(InputError, match="root of the file system"), stage("/"):
            pass
    with pytest.raises(InputError, match="file: output: is a file"), staged_folder(tmp_path / "file"):
        pass
    with pytest.raises(InputError, match="output: is a folder"), staged_file(tmp_path):
        pass
    assert names(tmp_path) == ["file"]


def test_a_folder_without_permission_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root, who may run the tests, may write everywhere
    with (
        pytest.raises(InputError, match=r"out: output: the folder .* cannot be written"),
        staged_folder(tmp_path / "out"),
    ):
        pass


def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    """The kernel's own limit on file size stands in for a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20000, hard))
    noise = np.random.default_rng(0).random((100, 100, 3))
    try:
        with pytest.raises(InputError, match=r"set: output: cannot be written \(File too large\)"):
            write_dataset(tmp_path / "set", name="s", frames=[(Light(direction=(0, 0, 1)), noise)])
        with (
            pytest.raises(InputError, match=r"a\.exr: output: cannot be written"),
            staged_file(tmp_path / "a.exr") as file,
        ):
            write_exr(file, noise)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert names(tmp_path) == []


def test_a_fault_of_something_read_is_not_blamed_on_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), staged_folder(tmp_path / "out"):
        (tmp_path / "input").read_text()
    with pytest.raises(OSError) as caught, staged_folder(tmp_path / "out"):
        raise OSError(errno.ECONNRESET, "reset")
    assert caught.value.errno == errno.ECONNRESET
    assert names(tmp_path) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_killed_process_cleans_up(tmp_path: Path, number: signal.Signals) -> None:
    program = f"""
        import sys, signal
        from acquisition.dataset import staged_folder
        with staged_folder({str(tmp_path / "out")!r}) as folder:
            (folder / "half").write_text("half")
            print("ready", flush=True)
            signal.pause()
    """
    arguments = [sys.executable, "-c", textwrap.dedent(program)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert len(names(tmp_path)) == 1
        process.send_signal(number)
        process.communicate(timeout=60)
    assert process.returncode in (128 + number, -number)
    assert names(tmp_path) == []


def test_handlers_of_others_are_left_alone(tmp_path: Path) -> None:
    def theirs(*_: object) -> None:
        raise AssertionError

    before = signal.signal(signal.SIGTERM, theirs)
    try:
        with staged_folder(tmp_path / "out"):
            assert signal.getsignal(signal.SIGTERM) is theirs
        assert signal.getsignal(signal.SIGTERM) is theirs
    finally:
        signal.signal(signal.SIGTERM, before)
    with staged_folder(tmp_path / "more"):
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    assert signal.getsignal(signal.SIGTERM) is before
