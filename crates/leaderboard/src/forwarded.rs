//! The address of a visitor behind proxies.
//!
//! A proxy appends the address that it was asked from to `X-Forwarded-For`; anybody may send that header, so only the part that trusted
//! proxies wrote counts: it is read from its end, as long as the addresses are those of proxies.

use std::net::IpAddr;
use std::str::FromStr;

use axum::http::{HeaderMap, header};

/// Networks that are nobody's public address: containers, private networks, links.
const PRIVATE: [&str; 6] = ["10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "169.254.0.0/16", "fc00::/7", "fe80::/10"];

/// An address, or the network of a prefix such as `10.0.0.0/8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Network {
    address: IpAddr,
    bits: u32,
}

/// Addresses of proxies besides those of this machine.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Proxies {
    named: Vec<Network>,
    /// Whoever connects from a private network is a proxy. Visitors may be in one, too, so this says nothing of the addresses that a
    /// proxy writes.
    is_private: bool,
}

/// A text that names no proxies.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}: give an address such as 10.0.0.7, a network such as 10.0.0.0/8, or the word private")]
pub struct ProxyError(String);

impl Network {
    fn contains(self, other: IpAddr) -> bool {
        let shift = |width: u32| width - self.bits;
        match (self.address, other) {
            (IpAddr::V4(own), IpAddr::V4(other)) => {
                (own.to_bits() ^ other.to_bits()).checked_shr(shift(32)).unwrap_or(0) == 0
            }
            (IpAddr::V6(own), IpAddr::V6(other)) => {
                (own.to_bits() ^ other.to_bits()).checked_shr(shift(128)).unwrap_or(0) == 0
            }
            _ => false,
        }
    }
}

impl FromStr for Network {
    type Err = ProxyError;

    fn from_str(text: &str) -> Result<Self, ProxyError> {
        let refused = || ProxyError(text.to_owned());
        let (address, bits) = text.split_once('/').map_or((text, None), |(address, bits)| (address, Some(bits)));
        let address: IpAddr = address.parse().map_err(|_| refused())?;
        let width = if address.is_ipv4() { 32 } else { 128 };
        let bits = bits.map_or(Ok(width), str::parse).map_err(|_| refused())?;
        if bits > width { Err(refused()) } else { Ok(Self { address, bits }) }
    }
}

impl FromStr for Proxies {
    type Err = ProxyError;

    /// Reads an address, a network, or `private`: the networks that are nobody's public address.
    fn from_str(text: &str) -> Result<Self, ProxyError> {
        match text {
            "private" => Ok(Self { named: Vec::new(), is_private: true }),
            _ => Ok(Self { named: vec![text.parse()?], is_private: false }),
        }
    }
}

impl FromIterator<Self> for Proxies {
    fn from_iter<T: IntoIterator<Item = Self>>(all: T) -> Self {
        all.into_iter().fold(Self::default(), |mut sum, proxies| {
            sum.named.extend(proxies.named);
            sum.is_private |= proxies.is_private;
            sum
        })
    }
}

impl Proxies {
    /// True if a connection from `peer` to the address `own` of this machine is one of a proxy. A program of this machine may use any
    /// of its addresses.
    pub(crate) fn has(&self, peer: IpAddr, own: IpAddr) -> bool {
        let is_private =
            || PRIVATE.iter().filter_map(|text| text.parse::<Network>().ok()).any(|network| network.contains(peer));
        peer == own || self.is_proxy(peer) || (self.is_private && is_private())
    }

    fn is_proxy(&self, address: IpAddr) -> bool {
        address.is_loopback() || self.named.iter().any(|network| network.contains(address))
    }

    /// The address of whoever asked a proxy, which asked from `peer`: the last one that is no proxy itself.
    pub(crate) fn visitor(&self, peer: IpAddr, headers: &HeaderMap) -> IpAddr {
        let names = |name: &str| headers.get_all(name).iter().rev().filter_map(|value| value.to_str().ok());
        let by_name = || names("x-forwarded-for").flat_map(|list| list.rsplit(',').map(str::trim));
        let standard = || {
            let lists = names(header::FORWARDED.as_str()).flat_map(|list| list.rsplit(','));
            lists.map(|element| {
                let pairs = element.split(';').filter_map(|pair| pair.trim().split_once('='));
                pairs
                    .filter(|(name, _)| name.eq_ignore_ascii_case("for"))
                    .map(|(_, value)| value)
                    .next()
                    .unwrap_or_default()
            })
        };
        // Proxies that write the standard's header alone pass on what visitors wrote into the other one: that counts only where the
        // standard's is missing.
        if headers.contains_key(header::FORWARDED) && !headers.contains_key("x-forwarded-for") {
            self.last(peer, standard())
        } else {
            self.last(peer, by_name())
        }
    }

    /// The first address that is no proxy's, in a list from the nearest on; the last proxy where what follows is no address.
    fn last<'a>(&self, peer: IpAddr, nearest_first: impl Iterator<Item = &'a str>) -> IpAddr {
        let mut found = peer;
        for text in nearest_first {
            let Some(address) = address_of(text) else { break };
            found = address;
            if !self.is_proxy(address) {
                break;
            }
        }
        found
    }
}

/// The address in an entry: `203.0.113.7`, `203.0.113.7:1234`, `2001:db8::7`, `[2001:db8::7]`, `"[2001:db8::7]:1234"`, with a zone or not.
fn address_of(entry: &str) -> Option<IpAddr> {
    let entry = entry.trim().trim_matches('"');
    let name = match entry.strip_prefix('[') {
        Some(rest) => rest.split_once(']')?.0,
        // One colon is before a port; an address of version 6 has more.
        None if entry.matches(':').count() == 1 => entry.split_once(':')?.0,
        None => entry,
    };
    let name = name.split_once('%').map_or(name, |(name, _)| name);
    name.parse::<IpAddr>().ok().map(|address| address.to_canonical())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use axum::http::{HeaderName, HeaderValue};

    use super::*;

    fn proxies(texts: &[&str]) -> Proxies {
        texts.iter().map(|text| text.parse::<Proxies>().unwrap()).collect()
    }

    fn visitor(proxies: &Proxies, headers: &[(&'static str, &'static str)]) -> String {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(HeaderName::from_static(name), HeaderValue::from_static(value));
        }
        proxies.visitor("127.0.0.1".parse().unwrap(), &map).to_string()
    }

    /// The spellings of proxies of several makes.
    #[test]
    fn ports_brackets_and_quotes_are_read() {
        let none = Proxies::default();
        for (text, expected) in [
            ("203.0.113.7", "203.0.113.7"),
            // Azure's gateways.
            ("203.0.113.7:51234", "203.0.113.7"),
            ("2001:db8::7", "2001:db8::7"),
            ("[2001:db8::7]", "2001:db8::7"),
            ("[2001:db8::7]:51234", "2001:db8::7"),
            ("::ffff:203.0.113.7", "203.0.113.7"),
            ("2001:db8::7%eth0", "2001:db8::7"),
            ("198.51.100.1, 203.0.113.7", "203.0.113.7"),
            ("198.51.100.1,203.0.113.7 ", "203.0.113.7"),
            // Nobody knows: as if nothing had been sent.
            ("unknown", "127.0.0.1"),
            ("", "127.0.0.1"),
            ("203.0.113.7, unknown", "127.0.0.1"),
            ("203.0.113", "127.0.0.1"),
            ("[2001:db8::7", "127.0.0.1"),
        ] {
            assert_eq!(visitor(&none, &[("x-forwarded-for", text)]), expected, "{text}");
        }
        for (text, expected) in [
            ("for=203.0.113.7;proto=https", "203.0.113.7"),
            ("proto=https;For=\"[2001:db8::7]:4711\"", "2001:db8::7"),
            ("for=198.51.100.1, for=203.0.113.7:80;by=10.0.0.1", "203.0.113.7"),
            ("for=_hidden", "127.0.0.1"),
            ("proto=https", "127.0.0.1"),
        ] {
            assert_eq!(visitor(&none, &[("forwarded", text)]), expected, "{text}");
        }
        assert_eq!(visitor(&none, &[]), "127.0.0.1");
    }

    #[test]
    fn a_visitor_cannot_choose_its_address() {
        let inner = proxies(&["10.89.0.0/16"]);
        assert_eq!(visitor(&inner, &[("x-forwarded-for", "6.6.6.6, 203.0.113.7, 10.89.0.4")]), "203.0.113.7");
        assert_eq!(visitor(&inner, &[("x-forwarded-for", "6.6.6.6, 203.0.113.7, 10.90.0.4")]), "10.90.0.4");
        // A header that is there twice counts as one list.
        let twice = [("x-forwarded-for", "6.6.6.6"), ("x-forwarded-for", "203.0.113.7")];
        assert_eq!(visitor(&inner, &twice), "203.0.113.7");
        // All are proxies: the outermost one asked itself.
        assert_eq!(visitor(&inner, &[("x-forwarded-for", "10.89.0.9, 10.89.0.4")]), "10.89.0.9");
    }

    #[test]
    fn proxies_are_addresses_networks_and_a_word() {
        let own: IpAddr = "10.9.9.1".parse().unwrap();
        let has = |proxies: &Proxies, peer: &str| proxies.has(peer.parse().unwrap(), own);
        let none = Proxies::default();
        assert!(has(&none, "127.0.0.1") && has(&none, "::1"));
        assert!(has(&none, "10.9.9.1"), "a program of this machine");
        assert!(!has(&none, "10.9.9.2"));
        let some = proxies(&["10.89.0.0/16", "2001:db8::/32", "192.0.2.7"]);
        assert!(has(&some, "10.89.255.1") && has(&some, "2001:db8:1::1") && has(&some, "192.0.2.7"));
        assert!(!has(&some, "10.90.0.1") && !has(&some, "2001:db9::1") && !has(&some, "192.0.2.8"));
        let private = proxies(&["private"]);
        for peer in ["10.1.2.3", "172.31.0.9", "192.168.7.7", "fd00::5"] {
            assert!(has(&private, peer), "{peer}");
        }
        // A visitor of the same private network writes an address before its own.
        assert_eq!(visitor(&private, &[("x-forwarded-for", "6.6.6.6, 192.168.7.9")]), "192.168.7.9");
        for peer in ["172.32.0.1", "203.0.113.7", "2001:db8::1"] {
            assert!(!has(&private, peer), "{peer}");
        }
        assert!(has(&proxies(&["0.0.0.0/0"]), "203.0.113.7"));
        for text in ["", "lab", "10.0.0.0/33", "10.0.0.0/", "10.0.0.0/-1", "10.0.0/8", "::/129"] {
            assert!(text.parse::<Proxies>().unwrap_err().to_string().contains("10.0.0.0/8"), "{text}");
        }
    }
}
