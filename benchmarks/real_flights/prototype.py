"""What a prototype of the inference left of held-out flights, to be seen beside `explain`.

Figures are rms of RflySimDT's real flights, each held out and predicted from the other two, vehicle
file `feisi_x150`. They were measured once, before the inference in `twin.explain` was written
(docs/dev/decisions/inference.md), and are not measured again.
"""

FLIGHTS = ("real_1", "real_2", "real_3")
SCENARIO = "real"
RMS: dict[str, tuple[float, float, float]] = {
    "acc_y": (0.222, 0.268, 0.390),
    "acc_z": (0.781, 0.319, 0.279),
    "gyro_rate_x": (3.05, 4.70, 3.59),
    "gyro_rate_y": (1.75, 2.32, 3.73),
    "gyro_rate_z": (1.86, 2.05, 1.45),
    "pose_gyro_x": (4.64e-3, 5.89e-3, 5.24e-3),
    "mag_x": (7.2e-6, 10.7e-6, 6.5e-6),
    "baro_pa": (24.2, 14.8, 10.3),
}
"""In the unit of the channel, by flight held out."""
BANDS: dict[str, tuple[tuple[float, ...], ...]] = {
    "gyro_rate_x": ((2.75, 0.65, 0.82, 0.82), (4.04, 1.06, 0.95, 1.32), (3.42, 0.65, 0.85, 0.87)),
    "gyro_rate_y": ((1.4, 0.5, 0.66, 0.6), (1.8, 0.6, 0.68, 1.0), (3.7, 0.5, 0.58, 0.7)),
    "gyro_rate_z": ((1.4, 0.3, 0.6, 1.0), (0.7, 0.5, 1.2, 1.4), (0.4, 0.5, 0.8, 1.1)),
}
"""By band of `bands.NAMES`, rad/s2, by flight held out."""
