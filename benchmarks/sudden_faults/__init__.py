"""Sudden faults planted in simulated flights, and what `why` says of them without a vehicle file.

    SCIPY_ARRAY_API=1 python -m benchmarks.sudden_faults [--plant P ...] [--seeds N] [--journal J]

Fourteen kinds of faults in three sizes (`kinds`) in closed loop, in wind and turbulence, in four
plants (`flights`): the project's own, drone-models, JSBSim's F450 and RotorPy's Hummingbird; the
last three are other people's dynamics, flown by our controller. Seeds below 1000 chose numbers of
`twin.why`, those from 1000 on are scored. A journal keeps each answer, so that a run goes on where
it ended. Beside it stands the trivial rule: when the outputs part by 150 us after six seconds of
flight, the highest is the failed rotor. `built_in` flies quicker and less, for tests and
`clean_flights`.
"""
