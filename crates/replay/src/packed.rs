//! Bytes that are stored and sent in compressed form.

use std::io::{Read, Write};

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packed(Bytes);

/// Bytes as small as gzip makes them, without a time in them: the same each time.
pub(crate) fn small(bytes: &[u8]) -> Vec<u8> {
    gzip(bytes, Compression::best())
}

fn gzip(bytes: &[u8], level: Compression) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), level);
    // Writing to memory does not fail.
    encoder.write_all(bytes).and_then(|()| encoder.finish()).unwrap_or_default()
}

impl Packed {
    pub fn new(bytes: &[u8]) -> Self {
        Self(gzip(bytes, Compression::fast()).into())
    }

    pub fn unpacked(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        // This type's own output can always be decompressed.
        drop(GzDecoder::new(self.0.as_ref()).read_to_end(&mut bytes));
        bytes
    }

    /// An answer of this media type: compressed if the request accepts gzip.
    pub fn answer(&self, asked: &HeaderMap, kind: &'static str) -> Response {
        let takes = |value: &HeaderValue| value.to_str().is_ok_and(takes_gzip);
        let is_packed = asked.get_all(header::ACCEPT_ENCODING).iter().any(takes);
        let body = if is_packed { self.0.clone() } else { self.unpacked().into() };
        let mut answer = ([(header::CONTENT_TYPE, kind), (header::VARY, "accept-encoding")], body).into_response();
        if is_packed {
            answer.headers_mut().insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        answer
    }
}

/// True if a list such as `br, gzip;q=0.8` has gzip with a weight above 0.
fn takes_gzip(list: &str) -> bool {
    list.split(',').any(|entry| {
        let (name, parameters) = entry.split_once(';').unwrap_or((entry, ""));
        let is_refused = parameters.trim().strip_prefix("q=").is_some_and(|q| q.trim().parse::<f64>() == Ok(0.0));
        name.trim().eq_ignore_ascii_case("gzip") && !is_refused
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_comes_back() {
        let bytes: Vec<u8> = (0..100_000_u32).map(|i| (i / 7) as u8).collect();
        let packed = Packed::new(&bytes);
        assert!(packed.0.len() < bytes.len() / 10);
        assert_eq!(packed.unpacked(), bytes);
    }

    #[test]
    fn only_who_asks_gets_gzip() {
        let cases = [
            ("gzip", true),
            ("br, GZIP;q=0.8", true),
            ("gzip;q=0", false),
            ("br", false),
            ("", false),
            ("xgzip", false),
        ];
        for (list, expected) in cases {
            let mut asked = HeaderMap::new();
            asked.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(list));
            let answer = Packed::new(b"x").answer(&asked, "text/plain");
            assert_eq!(answer.headers().contains_key(header::CONTENT_ENCODING), expected, "{list}");
        }
    }
}
