"""One thread at a time builds CasADi's expressions.

CasADi lets go of Python's lock while it works, which evaluation bears and building does not: two
threads that build at once may end the process. Where threads run alongside each other, as live
flights do, each that builds, or calls a function with CasADi's own matrices, holds this lock.
"""

import threading

BUILDING = threading.RLock()
"""Held while expressions and functions are made."""
