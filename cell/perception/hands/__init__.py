"""Hands in colour images: the published palm and hand-landmark networks, and what the hand says.

Landmarks (21), the networks' numbering: 0 wrist; thumb 1 CMC, 2 MCP, 3 IP, 4 tip; index 5 MCP,
6 PIP, 7 DIP, 8 tip; middle 9-12; ring 13-16; little 17-20.
"""

from __future__ import annotations
