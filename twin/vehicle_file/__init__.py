"""Vehicle files: TOML with unit and source of every number."""

from .read import builtin_vehicles, load_vehicle, parse_vehicle, vehicle_text

__all__ = ["builtin_vehicles", "load_vehicle", "parse_vehicle", "vehicle_text"]
