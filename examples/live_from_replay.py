"""A flight sent as a MAVLink aircraft, and heard by the twin beside it: both in one program.

You will see what the twin says while it flies, and which rotor it finds damaged, seconds after:
    python examples/live_from_replay.py [LOG VEHICLE]
Without a log, a built-in flight in which a rotor loses a fifth of its thrust at 16 s.
"""

import socket
import sys
import threading
from pathlib import Path

from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.watch import Watch
from uavtwin.demo.in_flight import damaged_flight
from uavtwin.live.replay import MAX_SPEED, Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.sockets import Address


def free_address() -> Address:
    """On this machine, of a port that nobody listens at."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return Address("127.0.0.1", any_port.getsockname()[1])


def main(flight: Flight, vehicle: Vehicle) -> None:
    """Send, listen, print what is said."""
    options = LiveOptions(free_address(), until_silent_s=2.0)
    session = LiveSession(vehicle, options, lambda: Watch(vehicle))
    aircraft = Replay(options.listen, MAX_SPEED)  # in step with who listens; 1.0: in real time
    sender = threading.Thread(target=aircraft.play, args=(flight,))
    sender.start()
    status = session.run(on_status=lambda now: print(now.line()))
    sender.join()
    aircraft.close()
    for alarm in status.alarms:
        print(f"{alarm['raised_s']:.1f} s: {alarm['text']}")
    rms, lost = status.rms["acc_z"], status.link.lost
    print(f"residual of acc_z: {rms:.3f} m/s2 rms; {lost} messages lost")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        main(read_flight(Path(sys.argv[1])), load_vehicle(sys.argv[2]))
    else:
        twin = load_vehicle("copter_default")
        main(damaged_flight(twin, begins_s=16.0, seconds=20.0), twin)
