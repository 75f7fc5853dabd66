"""Access rules of the server: hosts, origins, tokens.

A browser also shows pages of other origins, which may try to read those of this site: a foreign
name that resolves to this machine (DNS rebinding) is detected by the host of the request, a foreign
script by its origin.
"""

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass
from hmac import compare_digest

from twin.errors import TwinError

_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\s\[\]/]+)(:[0-9]{1,5})?")
"""Host, and port if it is given."""
SHORTEST_TOKEN = 8
"""Least number of characters of a token. Made up."""
TOKEN_HEADER = "x-uavtwin-token"  # HTTP header of a viewer's token


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True)
class AccessPolicy:
    """Rules that accept or refuse requests.

    Attributes:
        host: Name or address of the server.
        token: Token of viewers; None: none.
        cookie: Name of the cookie with the token; "": none.
    """

    host: str
    token: str | None = None
    cookie: str = ""

    def __post_init__(self) -> None:
        if self.token is not None and len(self.token) < SHORTEST_TOKEN:
            raise TwinError(
                f"a token of {len(self.token)} characters: at least {SHORTEST_TOKEN} are needed."
            )

    def fits(self, given: str) -> bool:
        """Whether this is the token; False without one."""
        return self.token is not None and compare_digest(given.encode(), self.token.encode())

    def refusal(
        self,
        headers: Mapping[str, str],
        query: Mapping[str, str],
        cookies: Mapping[str, str] | None = None,
    ) -> str:
        """Reason why a request is refused; "": it is accepted.

        Args:
            headers: Headers by name in lower case.
            query: Query of its address.
            cookies: Cookies of the request.
        """
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
            cookie = (cookies or {}).get(self.cookie)
            given = headers.get(TOKEN_HEADER) or query.get("token") or cookie or ""
            if not self.fits(given):
                return "This page needs its token: add ?token=TEXT to the address."
        return ""

    def _is_ours(self, host: str) -> bool:
        """Whether the host is this site's: a literal address cannot be resolved to another one; a
        foreign name can, but has no cookie of this site."""
        if host in ("localhost", self.host) or self.cookie:
            return True
        try:
            ipaddress.ip_address(host.strip("[]"))
        except ValueError:
            return False
        return True
