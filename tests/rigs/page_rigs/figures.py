"""What the figures of a page hold."""

import gzip
import json
import re
from base64 import b64decode
from typing import Any


def figures_of(page: str) -> dict[str, Any]:
    """Figures of a page by identifier, as plotly.js gets them."""
    found = re.search(r'id="figures">([^<]*)<', page)
    assert found is not None
    return dict(json.loads(gzip.decompress(b64decode(found[1]))))
