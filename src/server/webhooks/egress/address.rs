//! Classification of public addresses.
//!
//! Anyone who may add a webhook can make the server connect to its URL. Services on internal
//! networks, such as the metadata service of a cloud, trust everyone who can reach them.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Returns whether an address is publicly reachable.
pub(super) fn is_outer(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(address) => is_outer_v4(address),
        IpAddr::V6(address) => is_outer_v6(address),
    }
}

fn is_outer_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let inner = address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_multicast()
        || address.is_documentation()
        // This network, shared address space, protocol assignments, 6to4 relays, benchmarks,
        // reserved.
        || a == 0
        || (a == 100 && b & 0xc0 == 64)
        || (a == 192 && b == 0 && c == 0)
        || (a == 192 && b == 88 && c == 99)
        || (a == 198 && b & 0xfe == 18)
        // The platform address of a cloud, reachable only by its own machines.
        || address == Ipv4Addr::new(168, 63, 129, 16)
        || a >= 240;
    !inner
}

fn is_outer_v6(address: Ipv6Addr) -> bool {
    let [a, b, c, d, e, f, ..] = address.segments();
    // NAT64: the embedded IPv4 address counts.
    if [a, b, c, d, e, f] == [0x64, 0xff9b, 0, 0, 0, 0] {
        let [.., w, x, y, z] = address.octets();
        return is_outer_v4(Ipv4Addr::new(w, x, y, z));
    }
    let is_global_unicast = a & 0xe000 == 0x2000;
    // Documentation, and addresses that embed another: Teredo, 6to4.
    let is_special = (a == 0x2001 && (b == 0 || b == 0xdb8)) || a == 0x2002 || a == 0x3fff;
    is_global_unicast && !is_special
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_public_addresses_are_outer() {
        let parse = |text: &str| text.parse::<IpAddr>().expect(text);
        for outer in [
            "1.1.1.1",
            "93.184.216.34",
            "100.128.0.1",
            "2606:4700::1111",
            "::ffff:8.8.8.8",
            "64:ff9b::808:808",
        ] {
            assert!(is_outer(parse(outer)), "{outer}");
        }
        let inner = [
            "127.0.0.1",
            "127.9.9.9",
            "10.1.2.3",
            "172.16.0.1",
            "192.168.1.1",
            "169.254.169.254",
            "100.64.0.1",
            "0.0.0.0",
            "192.0.0.8",
            "192.0.2.1",
            "198.18.0.1",
            "198.51.100.1",
            "224.0.0.1",
            "255.255.255.255",
            "240.0.0.1",
            "::1",
            "::",
            "fe80::1",
            "fd00::1",
            "fc00::1",
            "ff02::1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "::127.0.0.1",
            "64:ff9b::7f00:1",
            "168.63.129.16",
            "2002:7f00:1::",
            "2001::1",
            "2001:db8::1",
        ];
        for inner in inner {
            assert!(!is_outer(parse(inner)), "{inner}");
        }
    }
}
