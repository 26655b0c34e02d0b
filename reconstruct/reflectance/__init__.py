"""Closed forms of how a surface point answers light."""
