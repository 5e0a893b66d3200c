//! Which addresses are out in the world.
//!
//! Whoever may name an address for webhooks has the server knock there. At those of its own network
//! stand things that trust whoever can reach them, such as the metadata service of a cloud.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Whether an address is one that anybody in the world reaches.
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
        // This network, shared address space, protocol assignments, benchmarks, the future.
        || a == 0
        || (a == 100 && b & 0xc0 == 64)
        || (a == 192 && b == 0 && c == 0)
        || (a == 192 && b == 88 && c == 99)
        || (a == 198 && b & 0xfe == 18)
        // Where a cloud answers its own machines.
        || address == Ipv4Addr::new(168, 63, 129, 16)
        || a >= 240;
    !inner
}

fn is_outer_v6(address: Ipv6Addr) -> bool {
    let [a, b, c, d, e, f, ..] = address.segments();
    // Where a network without IPv4 reaches it, the address of IPv4 counts.
    if [a, b, c, d, e, f] == [0x64, 0xff9b, 0, 0, 0, 0] {
        let [.., w, x, y, z] = address.octets();
        return is_outer_v4(Ipv4Addr::new(w, x, y, z));
    }
    let is_global_unicast = a & 0xe000 == 0x2000;
    // Documentation, and those that carry another address inside: Teredo, 6to4.
    let is_special = (a == 0x2001 && (b == 0 || b == 0xdb8)) || a == 0x2002 || a == 0x3fff;
    is_global_unicast && !is_special
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_out_in_the_world_are() {
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
