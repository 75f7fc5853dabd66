"""The twin of a flying aircraft, over MAVLink; and a log played as one."""
