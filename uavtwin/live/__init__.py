"""The twin beside a flying aircraft, over MAVLink; and a log played as one."""
