"""A driven twin as it is used: which readings are learned, which corrections stay on."""

from collections.abc import Iterator

import numpy as np
import pytest

from learning.data.channels import CHANNELS
from learning.data.flights import Pass, ResidualFlight
from twin.vehicle_file import load_vehicle
from uavtwin.compensators.in_use import (
    ALONE,
    FOLLOWING,
    SOURCES,
    WORST,
    ChannelInUse,
    InUseRecord,
    UsedFlight,
    driven_fmu,
    harmful,
)
from uavtwin.compensators.training import imu_rate_hz
from uavtwin.demo.flights import fly
from uavtwin.vehicles import Vehicle, checked_vehicle

COPTER = load_vehicle("copter_default")
RATE_HZ = 50.0
ACC, POS = CHANNELS.index("acc_x"), CHANNELS.index("pos_x")


@pytest.fixture(scope="module")
def used() -> UsedFlight:
    place = (2.0, 1.0, -1.5)
    legs = (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 2.0, (0.0, 0.0, -1.5)),
        ("tour", 3.0, place),
    )
    return UsedFlight(fly(COPTER, COPTER, 1, "one", legs), COPTER)


@pytest.fixture(scope="module")
def seen(used: UsedFlight) -> Iterator[tuple[list[Pass], ResidualFlight]]:
    """What the exported twin read, and the residuals that are learned."""
    vehicle: Vehicle = checked_vehicle(COPTER, "test")
    with driven_fmu(vehicle, "command") as fmu:
        yield used.through(fmu, SOURCES), used.residuals(fmu, RATE_HZ)


@pytest.mark.slow
def test_an_instant_learns_the_readings_that_its_correction_is_held_for(
    used: UsedFlight, seen: tuple[list[Pass], ResidualFlight]
) -> None:
    """Read off the passes by hand: the last sample after an instant and up to the next."""
    passes, residual = seen
    t_s, acc = used.flight.signal(["acc_x"])
    grid_s = used.aligned.inputs.t_s
    n = len(residual.t_s) // len(passes)
    rows = [r for r in range(n) if residual.fresh[r, ACC]]
    assert len(rows) > 20
    for row in rows:
        start = residual.t_s[row]
        k = np.flatnonzero((t_s > start + 1e-9) & (t_s <= start + 1 / RATE_HZ + 1e-9))[-1]
        own = np.interp(t_s[k], grid_s, passes[0].shown[:, ACC])
        assert residual.residual[row, ACC] == pytest.approx(acc[k, 0] - own, abs=1e-9)


@pytest.mark.slow
def test_every_moment_is_flown_alone_once(
    used: UsedFlight, seen: tuple[list[Pass], ResidualFlight]
) -> None:
    passes, residual = seen
    times = np.sum([one.alone & one.counts for one in passes], axis=0)
    assert set(times[2500:-600]) == {1}
    assert not residual.fresh[~residual.alone_rows, POS].any()  # given to a twin that follows
    assert residual.fresh[residual.alone_rows, POS].any()


def _record(**ratios: tuple[float, float]) -> InUseRecord:
    """Ratio following and alone, by channel."""
    rows = tuple(
        ChannelInUse(
            channel=c,
            mode=m,
            n=9,
            uncorrected=2.0,
            corrected=2 * r,
            last_reading=1.5,
            mean_reading=3.0,
        )
        for c, both in ratios.items()
        for m, r in zip((FOLLOWING, ALONE), both, strict=True)
    )
    return InUseRecord(flights=("a",), taught="left out", shut=(), inside=1.0, channels=rows)


def test_a_correction_that_does_not_help_in_use_is_shut() -> None:
    good = _record(gyro_x=(0.8, 0.9), gyro_y=(0.8, 1.05), gyro_z=(0.5, 0.5), acc_x=(0.999, 0.999))
    bad = _record(
        gyro_x=(1.02, 0.9), gyro_y=(0.8, 1.0), gyro_z=(0.5, WORST + 0.01), acc_x=(0.99, 1)
    )
    assert harmful([good]) == ("gyro_y", "acc_x")
    assert harmful([good, bad]) == ("gyro_y", "gyro_z", "acc_x")


def test_the_claim_counts_what_is_on() -> None:
    found = _record(gyro_x=(0.8, 0.9), gyro_y=(0.7, 0.5))
    assert "following, 2 of 2 corrected channels closer, 0.75 of" in found.claim
    assert found.claim.count("1 of them worse than the last or the mean reading") == 2  # of 1.5
    assert "off" not in found.claim


def test_the_rate_is_that_of_the_slowest_imu(used: UsedFlight) -> None:
    assert imu_rate_hz([used.flight]) == pytest.approx(
        1000 / round(1e3 * np.median(np.diff(used.flight.signal(["gyro_x"])[0])))
    )
