"""The MAVLink dialect that is spoken, pymavlink's.

`ardupilotmega` is `common` and what ArduPilot adds, rotor speeds of its speed controllers among it.
ESC_STATUS of `common` is in no dialect of pymavlink 2.4.50.
"""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

dialect: Any = ardupilotmega
Message = Any
"""A message of pymavlink: its fields are attributes, its kind is `get_type()`."""
MARKERS = (dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2)
"""First bytes of a frame of MAVLink 1 and 2."""
GCS = dialect.MAV_TYPE_GCS
AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
BAD = "BAD_DATA"
"""Kind of what is no message, as pymavlink calls it."""
MOTORS = {
    dialect.MAV_TYPE_TRICOPTER: 3,
    dialect.MAV_TYPE_QUADROTOR: 4,
    dialect.MAV_TYPE_HEXAROTOR: 6,
    dialect.MAV_TYPE_OCTOROTOR: 8,
    dialect.MAV_TYPE_DECAROTOR: 10,
    dialect.MAV_TYPE_DODECAROTOR: 12,
}
"""Motors of an aircraft by the type in its heartbeat."""
TYPES = {count: kind for kind, count in MOTORS.items()}
AUTOPILOTS = {
    dialect.MAV_AUTOPILOT_PX4: "PX4",
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot",
    dialect.MAV_AUTOPILOT_GENERIC: "generic autopilot",
}


def parser(system: int = 0, component: int = 0) -> Any:
    """A parser and packer of frames that goes on after what is no message.

    Args:
        system: Own system id, of messages that are packed.
        component: Own component id.
    """
    made = dialect.MAVLink(None, system, component)
    made.robust_parsing = True
    return made
