"""What tests of pages share."""

from collections.abc import Iterator

import pytest
from page_rigs.browser import Browser, browser


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all tests of a module."""
    with browser(tmp_path_factory.mktemp("browser")) as one:
        yield one
