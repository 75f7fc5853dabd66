"""A motor and an amplifier, a loop of two parts."""

from twin.component import Component, ComponentBuilder


def motor() -> Component:
    """A lag."""
    m = ComponentBuilder("motor", "A lag")
    on = m.parameter("on", 1.0, "1", "Whether it turns", kind="boolean")
    u = m.input("u", "V", "Voltage")
    x = m.state("speed", "rad/s", "Speed", m.parameter("initial.speed", 0.0, "rad/s", "Start"))
    m.derivative("speed", on * (u - x))
    m.output("speed", "rad/s", "Speed", x)
    return m.build()


def amplifier() -> Component:
    """Feedback."""
    m = ComponentBuilder("amplifier", "Feedback")
    gain = m.parameter("gain", 2.0, "1", "Gain")
    speed = m.input("speed", "rad/s", "Speed")
    m.output("u", "V", "Voltage", gain * (1.0 - speed))
    return m.build()
