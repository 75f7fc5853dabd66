"""Who may see the page of a live flight.

A browser shows pages of others beside this one, and some of them would like to read it: a name of
theirs that resolves to this machine (DNS rebinding) is told by the host of the request, a script of
theirs that opens the WebSocket by its origin.
"""

import ipaddress
import re
from dataclasses import dataclass
from hmac import compare_digest

from starlette.datastructures import Headers, QueryParams

from twin.errors import TwinError

from ..address import Address

_FORM = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\s\[\]/]+):([0-9]{1,5})")
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\s\[\]/]+)(:[0-9]{1,5})?")
SHORTEST_TOKEN = 8
TOKEN_HEADER = "x-uavtwin-token"


def page_address(text: str, token: str | None) -> Address:
    """The address of `--serve`.

    Raises:
        TwinError: It is none, or others can reach it and there is no token to keep them out.
    """
    match = _FORM.fullmatch(text)
    if match is None or not 0 < int(match.group(2)) < 65536:
        raise TwinError(f"--serve {text}: write HOST:PORT, 127.0.0.1:8080.")
    where = Address(match.group(1).strip("[]"), int(match.group(2)))
    if token is not None and len(token) < SHORTEST_TOKEN:
        raise TwinError(f"--token: {len(token)} characters, at least {SHORTEST_TOKEN} are needed.")
    if token is None and not _is_loopback(where.host):
        raise TwinError(
            f"--serve {text}: others can reach that address. Give --token TEXT, which they then "
            f"need, or serve at 127.0.0.1:{where.port}."
        )
    return where


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True)
class Doors:
    """Lets in or refuses.

    Attributes:
        host: Name or address that is served at.
        token: What a viewer must know; None: nothing.
    """

    host: str
    token: str | None = None

    def refusal(self, headers: Headers, query: QueryParams) -> str:
        """Why a request is refused; "": it is not."""
        requested_host = headers.get("host", "")
        match = _HOST.fullmatch(requested_host)
        if match is None or not self._is_ours(match.group(1)):
            return "This page is served under its address alone."
        origin = headers.get("origin")
        if origin is not None and origin not in (
            f"http://{requested_host}",
            f"https://{requested_host}",
        ):
            return "Pages of others may not read this one."
        if self.token is not None:
            given = headers.get(TOKEN_HEADER) or query.get("token") or ""
            if not compare_digest(given.encode(), self.token.encode()):
                return "This page needs its token: add ?token=TEXT to the address."
        return ""

    def _is_ours(self, host: str) -> bool:
        """A literal address cannot be made to resolve to another; a name of others can."""
        if host in ("localhost", self.host):
            return True
        try:
            ipaddress.ip_address(host.strip("[]"))
        except ValueError:
            return False
        return True
