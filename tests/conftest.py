"""Fixtures that all test packages share."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# A shell that runs the tests in the background has Ctrl-C ignored, and what the tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine, or a kernel compiled on its first call, is no failure; in CI the same examples run every time.
settings.register_profile("lightstage", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("lightstage")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the reference photographs, which are not part of this repository."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the reference photographs (../shared/data from the project's root) are not here")
    return folder
