"""What the next photograph should be: belief about the object so far, and the light that teaches most."""

from __future__ import annotations

from reconstruct.next_light.next_light import Decision, NextLight, planned_surface

__all__ = ["Decision", "NextLight", "planned_surface"]
