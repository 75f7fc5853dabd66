"""Compensator: a learned correction of the virtual sensors as an FMU, from the ONNX file alone.

The file may come from anywhere. `network_file` reads it and `graph` judges it, `interface` makes
the interface table of an FMU of what it says, `c_source` makes C of the network.
"""

from .c_source import UnsupportedNetworkError, network_source
from .interface import compensator_model, interface_model, native_model
from .network_file import FILE, INT8_FILE, NetworkFile, read_network

__all__ = [
    "FILE",
    "INT8_FILE",
    "NetworkFile",
    "UnsupportedNetworkError",
    "compensator_model",
    "interface_model",
    "native_model",
    "network_source",
    "read_network",
]
