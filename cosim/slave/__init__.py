"""One FMU behind preallocated buffers."""
