"""The option that names a real stage; here, and not in ``tests``, so that pytest knows it before it looks for tests."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--rig``."""
    parser.addoption("--rig", metavar="rig.yaml", help="A real stage, for the tests that are marked 'hardware'.")
