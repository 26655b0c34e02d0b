"""From the record of a capture to datasets of linear pictures with their variance."""

from __future__ import annotations

from acquisition.developing.datasets import develop
from acquisition.developing.geometry import Geometry

__all__ = ["Geometry", "develop"]
