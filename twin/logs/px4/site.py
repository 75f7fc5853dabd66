"""Indoors or outdoors, by what told the autopilot where it is."""

import numpy as np

from ..flight import Site
from .log import Px4Log

_FIX_3D = 3
_GNSS = ("vehicle_gps_position", "sensor_gps")
_TRACKED = ("vehicle_visual_odometry", "vehicle_mocap_odometry")
_AID_VISION = 8 | 16
"""EKF2_AID_MASK of PX4 up to 1.13: position and yaw of external vision. EKF2_EV_CTRL, which follows
it, allows vision from the factory on and says nothing."""


def from_px4_site(log: Px4Log) -> Site | None:
    """A fix by satellites for at least half of the samples: outdoors; else a pose from outside, by
    cameras or motion capture: indoors; None where the log has neither."""
    for name in _GNSS:
        kinds = log.fields(name).get("fix_type")
        if kinds is not None and np.mean(kinds >= _FIX_3D) >= 0.5:
            return Site(False, f"{name} has a fix")
    for name in _TRACKED:
        if log.fields(name):
            return Site(True, f"{name} and no fix by satellites")
    mask = int(log.params.get("EKF2_AID_MASK", 0)) & _AID_VISION
    if mask:
        return Site(True, f"EKF2_AID_MASK takes external vision ({mask}), no fix by satellites")
    return None
