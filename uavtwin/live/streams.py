"""Which streams of an aircraft are there, and what cannot be told without those that are not."""

from collections.abc import Mapping

NEEDED_BY: dict[str, tuple[str, str]] = {
    "acc": ("HIGHRES_IMU", "nothing is told of forces: drag, thrust, mass"),
    "gyro": ("HIGHRES_IMU", "nothing is told of moments"),
    "q": ("ODOMETRY or ATTITUDE_QUATERNION", "the twin has no state and tells nothing"),
    "vel": (
        "ODOMETRY or LOCAL_POSITION_NED",
        "nothing is told of drag and wind, nor over a short horizon",
    ),
    "pos": (
        "ODOMETRY or LOCAL_POSITION_NED",
        "nothing is told of ground effect, and take-off goes by thrust alone",
    ),
    "cmd": (
        "ACTUATOR_OUTPUT_STATUS or SERVO_OUTPUT_RAW",
        "the twin has no commands and tells nothing",
    ),
    "vbat_v": ("BATTERY_STATUS", "nothing is told of a battery that sags"),
    "landed": ("EXTENDED_SYS_STATE", "flight phases are unknown"),
}


def missing(sources: Mapping[str, str]) -> dict[str, str]:
    """What is missing: by signal, which message to ask for, and what cannot be told."""
    return {
        group: f"no {message}: {what}"
        for group, (message, what) in NEEDED_BY.items()
        if group not in sources
    }
