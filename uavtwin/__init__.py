"""uavtwin: a hybrid digital twin of a multirotor UAV.

    import uavtwin as ut

    vehicle = ut.load_vehicle("mine.toml")            # or ut.vehicle("crazyflie")
    fit, held = ut.read_flights("fit_*.ulg"), ut.read_flights("other.ulg")
    print(ut.gap(fit[0], vehicle))
    found = ut.explain(fit, held, vehicle)
    ut.export(ut.twin(found.vehicle), "twin.fmu", fmi=(2, 3))
    run = ut.simulate("tour", found.vehicle, wind=(5, 0, 0))

Names are loaded on first use, so that the import takes almost no time.
"""

import sys
from typing import TYPE_CHECKING

if sys.platform == "win32":
    raise ImportError(
        "uavtwin does not run on Windows by itself. Install it in WSL 2 (wsl --install), or use "
        "the container of docs/guide/serve.md. FMUs of --platform win64 do run there."
    )

if TYPE_CHECKING:
    from twin.effects import EFFECTS
    from twin.errors import TwinError
    from twin.explain.settings import SearchSettings
    from twin.flight.mission import mission_names
    from twin.logs import Flight, Site, open_flight, read_flight, write_flight
    from twin.vehicle_file import builtin_vehicles

    from .calibration import CalibrateResult, calibrate
    from .diagnosis import WhyResult, why
    from .explanation import ExplainResult, explain
    from .exports.credibility import credibility
    from .exports.parts import Twin, compensator, component, learned_force, replay, twin
    from .exports.verify import VerifyResult, verify
    from .exports.write import export
    from .file_check import check_file as check
    from .fleets.fleet import fleet
    from .fleets.query import query
    from .fleets.result import FleetResult
    from .flights import read_flights
    from .gaps import GapResult, gap
    from .learned import evaluate, train
    from .run import Run, simulate
    from .sweeps.many import Runs, simulate_many
    from .sweeps.result import SweepResult
    from .sweeps.sweep import sweep
    from .vehicle_draft import DraftResult, draft_vehicle
    from .vehicles import Vehicle, convert_vehicle, load_vehicle, vehicle

    __version__: str

__all__ = [
    "EFFECTS",
    "CalibrateResult",
    "DraftResult",
    "ExplainResult",
    "FleetResult",
    "Flight",
    "GapResult",
    "Run",
    "Runs",
    "SearchSettings",
    "Site",
    "SweepResult",
    "Twin",
    "TwinError",
    "Vehicle",
    "VerifyResult",
    "WhyResult",
    "__version__",
    "builtin_vehicles",
    "calibrate",
    "check",
    "compensator",
    "component",
    "convert_vehicle",
    "credibility",
    "draft_vehicle",
    "evaluate",
    "explain",
    "export",
    "fleet",
    "gap",
    "learned_force",
    "load_vehicle",
    "mission_names",
    "open_flight",
    "query",
    "read_flight",
    "read_flights",
    "replay",
    "simulate",
    "simulate_many",
    "sweep",
    "train",
    "twin",
    "vehicle",
    "verify",
    "why",
    "write_flight",
]

_HOME = {
    "CalibrateResult": "uavtwin.calibration",
    "calibrate": "uavtwin.calibration",
    "DraftResult": "uavtwin.vehicle_draft",
    "EFFECTS": "twin.effects",
    "ExplainResult": "uavtwin.explanation",
    "FleetResult": "uavtwin.fleets.result",
    "Flight": "twin.logs",
    "GapResult": "uavtwin.gaps",
    "Run": "uavtwin.run",
    "Runs": "uavtwin.sweeps.many",
    "SearchSettings": "twin.explain.settings",
    "Site": "twin.logs",
    "SweepResult": "uavtwin.sweeps.result",
    "Twin": "uavtwin.exports.parts",
    "TwinError": "twin.errors",
    "Vehicle": "uavtwin.vehicles",
    "VerifyResult": "uavtwin.exports.verify",
    "WhyResult": "uavtwin.diagnosis",
    "builtin_vehicles": "twin.vehicle_file",
    "check": "uavtwin.file_check:check_file",
    "compensator": "uavtwin.exports.parts",
    "component": "uavtwin.exports.parts",
    "convert_vehicle": "uavtwin.vehicles",
    "credibility": "uavtwin.exports.credibility",
    "draft_vehicle": "uavtwin.vehicle_draft",
    "evaluate": "uavtwin.learned",
    "explain": "uavtwin.explanation",
    "export": "uavtwin.exports.write",
    "fleet": "uavtwin.fleets.fleet",
    "gap": "uavtwin.gaps",
    "learned_force": "uavtwin.exports.parts",
    "load_vehicle": "uavtwin.vehicles",
    "mission_names": "twin.flight.mission",
    "open_flight": "twin.logs",
    "query": "uavtwin.fleets.query",
    "read_flight": "twin.logs",
    "read_flights": "uavtwin.flights",
    "replay": "uavtwin.exports.parts",
    "simulate": "uavtwin.run",
    "simulate_many": "uavtwin.sweeps.many",
    "sweep": "uavtwin.sweeps.sweep",
    "train": "uavtwin.learned",
    "twin": "uavtwin.exports.parts",
    "vehicle": "uavtwin.vehicles",
    "verify": "uavtwin.exports.verify",
    "why": "uavtwin.diagnosis",
    "write_flight": "twin.logs",
}
"""Module of each name, and its name there if different. No name here is that of a module of this
package: importing the module would replace it."""

if not TYPE_CHECKING:  # a type checker then refuses unknown names

    def __getattr__(name: str) -> object:
        from importlib import import_module

        if name == "__version__":
            from importlib.metadata import version

            found: object = version("uavtwin")
        elif name in _HOME:
            module, _, there = _HOME[name].partition(":")
            found = getattr(import_module(module), there or name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted(__all__)
