"""A simulated arm of Universal Robots: controller, protocols of its ports, and the ports themselves."""

from __future__ import annotations

from simulators.ur.controller import Controller
from simulators.ur.server import UrServer

__all__ = ["Controller", "UrServer"]
