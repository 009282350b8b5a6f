"""udp_multicast as a bus of this machine: one group is one bus, and nothing from elsewhere is on it.

python-can binds to the port on every interface. The socket then takes what anybody sends to that port: other groups,
other machines, plain unicast. Here it is bound to the group's own address, and as long as no frame may leave the
machine (hop limit 0) it is a member on the loopback interface alone. Linux knows how; elsewhere it stays as it is.
"""

import socket
import struct
import sys
from typing import Any

from can.interfaces.udp_multicast.bus import SO_TIMESTAMPNS, GeneralPurposeUdpMulticastBus, UdpMulticastBus

LOOPBACK = socket.inet_pton(socket.AF_INET, "127.0.0.1")
IP_MULTICAST_ALL, IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h: off, only own memberships count


class GroupSocket(GeneralPurposeUdpMulticastBus):
    """The group's socket, made narrower after python-can has made it."""

    def _create_socket(self, address_family: socket.AddressFamily) -> socket.socket:
        wide = super()._create_socket(address_family)
        if sys.platform != "linux":
            return wide
        wide.close()
        sock = socket.socket(address_family, socket.SOCK_DGRAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            if self.timestamp_nanosecond:
                sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            group = socket.inet_pton(address_family, self.group)
            # on the loopback interface alone as long as nothing may leave the machine
            ip, ip6, hops = socket.IPPROTO_IP, socket.IPPROTO_IPV6, self.hop_limit
            if address_family == socket.AF_INET:
                sock.setsockopt(ip, socket.IP_MULTICAST_TTL, hops)
                sock.setsockopt(ip, IP_MULTICAST_ALL, 0)
                sock.setsockopt(ip, socket.IP_ADD_MEMBERSHIP, group + (bytes(4) if hops else LOOPBACK))
                if not hops:
                    sock.setsockopt(ip, socket.IP_MULTICAST_IF, LOOPBACK)
            else:
                sock.setsockopt(ip6, socket.IPV6_MULTICAST_HOPS, hops)
                sock.setsockopt(ip6, IPV6_MULTICAST_ALL, 0)
                sock.setsockopt(ip6, socket.IPV6_JOIN_GROUP, group + struct.pack("@I", 0))
            sock.bind((self.group, self.port))
        except OSError:
            sock.close()
            raise
        return sock


class GroupBus(UdpMulticastBus):
    """python-can's udp_multicast on such a socket."""

    def __init__(self, channel: str, port: int = 43113, hop_limit: int = 0, **kwargs: Any) -> None:
        super().__init__(channel, port=port, hop_limit=hop_limit, **kwargs)
        self._multicast.shutdown()
        self._multicast = GroupSocket(channel, port, hop_limit)
