"""Relighting from measured values alone: the apparent BRDF of Koudelka, Magda, Belhumeur and Kriegman (2001)."""
