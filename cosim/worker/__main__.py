"""`python -m cosim.worker REQUESTS ANSWERS BOARD BYTES`: started by `process` alone."""

import sys

from .serve import serve

serve(*map(int, sys.argv[1:]))
