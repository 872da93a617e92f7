"""Addresses of UDP in a TOML file: where packets come in and go out, and whose packets count.

INPUTS: fields such as ``listen = "127.0.0.1:39540"``, ``send = 9000``, ``from = ["10.0.0.0/24"]``.
OUTPUTS: Addresses; networks of senders.
"""

import re
import socket
from collections.abc import Sequence
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import Any, NamedTuple

from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.toml import TomlTable

Network = IPv4Network | IPv6Network
# This machine alone.
LOOPBACK: tuple[Network, ...] = (ip_network("127.0.0.0/8"), ip_network("::1/128"))
# No list of senders is longer.
MAX_NETWORKS = 64
# Digits of the first ten alone: Python's own int() takes those of every script.
_PORT = re.compile(r"[0-9]{1,5}")
MAX_PORT = 65535
# Names of hosts, as far as any resolver takes them.
_HOST = re.compile(r"(?:[A-Za-z0-9_-]{1,63}\.)*[A-Za-z0-9_-]{1,63}\.?")
MAX_HOST_CHARACTERS = 253


class Address(NamedTuple):
    """Where packets come in or go out."""

    host: str = "127.0.0.1"  # name or number; the loopback interface unless stated otherwise
    port: int = 0  # of UDP

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Is it reached from this machine alone?"""
        address = _number(self.host)
        return self.host == "localhost" if address is None else address.is_loopback


def read_address(fields: TomlTable, key: str, default: Address) -> Address:
    """An address as "host:port" or as a port alone, or the default; InputError for neither."""
    if key not in fields:
        return default
    host, value = "", fields.entries[key]
    port: Any = value
    if isinstance(value, str):
        host, _, text = value.rpartition(":")
        port = int(text) if _PORT.fullmatch(text) else None
        if host.startswith("[") and host.endswith("]"):
            host = host[1:-1]
    is_name = len(host) <= MAX_HOST_CHARACTERS and _HOST.fullmatch(host)
    is_port = isinstance(port, int) and not isinstance(port, bool) and 1 <= port <= MAX_PORT
    if not is_port or (host and not is_name and not (_number(host) and host.isprintable())):
        expected = f"an address such as '{default}', or a port from 1 to {MAX_PORT}"
        raise fields.error(key, f"found {short_repr(value)}, expected {expected}")
    return Address(host or default.host, port)


def _number(host: str) -> IPv4Address | IPv6Address | None:
    """A host's number, where it is stated by that."""
    try:
        return ip_address(host)
    except ValueError:
        return None


def resolve_address(address: Address) -> tuple[socket.AddressFamily, Any]:
    """Family and place as sockets take them, IPv4 before IPv6; InputError for no such host."""
    try:
        addresses = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not a host's name"
        raise InputError(str(address), f"no such address ({why})") from None
    best = min(addresses, key=lambda each: each[0] != socket.AF_INET)
    return best[0], best[4]


def read_allowed_networks(fields: TomlTable, listen: Address) -> tuple[Network, ...]:
    """The networks whose packets count: ``from``, or this machine where no other is listened to.

    InputError where it is no list of addresses, or is missing where other machines can send.
    """
    example = "['192.168.1.20'] or ['192.168.1.0/24']"
    if "from" not in fields:
        if listen.is_loopback:
            return LOOPBACK
        problem = f"'from' is missing, which lists who may send to {listen}, such as {example}"
        raise fields.error("", problem)
    value = fields.entries["from"]
    texts: Sequence[Any] = value if isinstance(value, list) else ()
    networks = [_network(text) for text in texts[: MAX_NETWORKS + 1]]
    valid = [network for network in networks if network is not None]
    if not 0 < len(networks) <= MAX_NETWORKS or len(valid) < len(networks):
        wrong = next((t for t, n in zip(texts, networks, strict=False) if n is None), value)
        expected = f"1 to {MAX_NETWORKS} addresses or networks such as {example}"
        raise fields.error("from", f"found {short_repr(wrong)}, expected {expected}")
    return tuple(valid)


def _network(text: Any) -> Network | None:
    try:
        return ip_network(text, strict=False) if isinstance(text, str) else None
    except ValueError:
        return None


def is_in_networks(host: str, networks: Sequence[Network]) -> bool:
    """Is a host, by its number, in one of the networks?"""
    address = _number(host)
    # What listens to both kinds sees one kind's numbers within the other's.
    if isinstance(address, IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    return address is not None and any(address in network for network in networks)
