"""Sensor compensators: training, simulation as FMUs, evaluation and figures."""
