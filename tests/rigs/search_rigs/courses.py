"""Flights that tests of the inference share, as waypoints."""

from uavtwin.demo.flights import Waypoints

LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (3.0, 1.0, -1.5)),
    ("tour", 2.0, (0.0, -2.0, -2.5)),
    ("tour", 2.0, (0.0, 0.0, -1.5)),
)
"""There and back in two directions, at two heights."""
TRIANGLE: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 3.0, (0.0, 0.0, -1.0)),
    ("forward", 3.0, (2.0, 1.0, -1.0)),
    ("forward", 3.0, (-1.0, 2.0, -1.0)),
    ("forward", 3.0, (0.0, 0.0, -1.3)),
    ("hover", 1.5, (0.0, 0.0, -1.3)),
)
"""Three legs nose first, then a hover."""
