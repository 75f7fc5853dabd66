"""Vehicle files whose numbers are off by the standard deviations that they state themselves.

The aircraft flies as it is; only the file is wrong. A deviation in per cent is one of what the
file says: true = file (1 + sd z), z standard normal. Places of rotors move together, as they do
when the centre of mass is not where the file has it.

Sizes are made up: a scale, a bifilar pendulum, a bench of thrust, a ruler. Each is taken half, once
or one and a half times, drawn by case and entry, so that who does not read it cannot know it.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..hiding.effect import AXES, Number, Truth, factor, factors, vector
from ..plants.aircraft import Aircraft
from ..plants.own.parameters import Array, Parameters

_SD = {"mass": 0.02, "inertia": 0.15, "thrust": 0.08, "torque": 0.15, "lag": 0.15}
"""Of what the file says."""
_PLACE_SD = {"rotors.position": 0.02, "imu.position": 0.08}
"""Of the arm."""
_TIMES = (0.5, 1.0, 1.5)


@dataclass(frozen=True)
class FileError:
    """One number of the file.

    Attributes:
        key: Entry of the vehicle file, with the axis where there are several.
        effect: Effect of the library that would put it right.
        true: SI; 1 where a map is meant as a whole.
        file: What the file has.
        sd: Standard deviation of `true` about `file`.
    """

    key: str
    effect: str
    true: float
    file: float
    sd: float

    @property
    def z(self) -> float:
        """How many standard deviations the truth is off."""
        return (self.true - self.file) / self.sd


@dataclass(frozen=True)
class WrongFile:
    """What the user believes.

    Attributes:
        believed: The aircraft of the vehicle file.
        sd: Standard deviations of entries as TOML, by "section.key".
        errors: Number by number.
    """

    believed: Aircraft
    sd: dict[str, str]
    errors: tuple[FileError, ...]


def wrong_file(aircraft: Aircraft, by_speed: bool, rng: np.random.Generator) -> WrongFile:
    """Draw what the file of an aircraft says; `by_speed`: its rotor speeds are measured."""
    p, errors = aircraft.nominal, list[FileError]()
    by_command = aircraft.by_command and not by_speed
    texts: dict[str, str] = {}

    def share(what: str, key: str) -> float:
        """A deviation in per cent, and its text."""
        sd = _SD[what] * float(rng.choice(_TIMES))
        texts[key] = f'"{100 * sd:g} %"'
        return sd

    def off(key: str, effect: str, true: float, sd: float) -> float:
        """What the file says where its relative deviation is `sd`."""
        file = true / (1 + sd * float(rng.standard_normal()))
        errors.append(FileError(key, effect, true, file, abs(sd * file)))
        return file

    mass = off("body.mass", "mass_offset", p.mass, share("mass", "body.mass"))
    sd = share("inertia", "body.inertia")
    inertia = [
        off(f"body.inertia.{a}", "inertia_error", float(v), sd)
        for a, v in zip(AXES, p.inertia, strict=True)
    ]
    thrust_key = f"rotors.thrust_from_{'command' if by_command else 'speed'}"
    thrust = off(thrust_key, "thrust_scale", 1.0, share("thrust", thrust_key))
    torque_key = f"rotors.torque_{'per_thrust' if by_command else 'from_speed'}"
    torque = off(torque_key, "yaw_torque_scale", 1.0, share("torque", torque_key)) * (
        thrust if by_command else 1.0
    )
    lag = p.lag if by_speed else off("rotors.lag", "motor_lag", p.lag, share("lag", "rotors.lag"))

    def moved(key: str, effect: str, true: Array) -> Array:
        """A place that is off, m."""
        sd = round(_PLACE_SD[key] * aircraft.arm * float(rng.choice(_TIMES)), 6)
        texts[key] = repr(sd)
        file = true - sd * rng.standard_normal(len(true))
        errors.extend(
            FileError(f"{key}.{a}", effect, float(t), float(f), sd)
            for a, t, f in zip(AXES, true, file, strict=False)
        )
        return np.asarray(file)

    middle = p.hubs[:, :2].mean(axis=0)
    shift = np.array([*(moved("rotors.position", "cog_offset", middle) - middle), 0.0])
    believed = replace(
        p,
        mass=mass,
        inertia=np.array(inertia),
        thrust_k=p.thrust_k * thrust,
        torque_k=p.torque_k * torque,
        lag=lag,
        hubs=p.hubs + shift,
        imu_arm=moved("imu.position", "imu_lever_arm", p.imu_arm),
    )
    user = replace(
        aircraft,
        nominal=believed,
        thrust_of_rpm=_times(thrust, aircraft.thrust_of_rpm),
        torque_of_rpm=_times(torque, aircraft.torque_of_rpm),
    )
    return WrongFile(user, texts, tuple(errors))


def _times(k: float, coefficients: tuple[float, ...] | None) -> tuple[float, ...] | None:
    return None if coefficients is None else tuple(k * c for c in coefficients)


def seen_from(file: Parameters, plant: Parameters) -> dict[str, Truth]:
    """Numbers by which what flies differs from a file, by the effect that has them: what is hidden
    and what is wrong with the file together.

    A rotor that has lost some of its thrust is no part of `thrust_scale`: the median of the rotors
    counts.
    """
    centre = np.mean(file.hubs - plant.hubs, axis=0)
    return {
        "mass_offset": {"mass_kg": Number(plant.mass - file.mass, "kg")},
        "inertia_error": factors("scale_{}", plant.inertia / file.inertia),
        "thrust_scale": {"scale": factor(float(np.median(plant.thrust_k / file.thrust_k)))},
        "yaw_torque_scale": {"scale": factor(float(np.median(plant.torque_k / file.torque_k)))},
        "motor_lag": {"tau_s": Number(plant.lag - file.lag, "s")},
        "cog_offset": vector("{}_m", centre[:2], "m"),
        "imu_lever_arm": vector("{}_m", plant.imu_arm - file.imu_arm + centre, "m"),
    }
