"""Shortest ways through a set of lights, in the seconds that the joints need, and how short they could be at best."""
