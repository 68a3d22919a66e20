//! A file as an answer, whole or in part (RFC 9110, sections 13 and 14), so that an interrupted download can go on, and a reader can ask
//! for the parts that it needs.

use std::io::{self, SeekFrom};
use std::ops::Range;
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use futures_core::Stream;
use tokio::fs::File;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncSeekExt as _, ReadBuf, Take};

/// Bytes to read from a file at once. Parts up to this size are sent from memory, with a size that is known beforehand.
const BLOCK: u64 = 64 << 10;

/// The answer to a request for a file. `tag` says which content it is: two contents never share one.
///
/// A request for several parts at once gets the whole file, as it may.
///
/// # Errors
/// The file cannot be read.
pub async fn download(
    mut file: File,
    tag: &str,
    kind: &'static str,
    method: &Method,
    asked: &HeaderMap,
) -> io::Result<Response> {
    let length = file.metadata().await?.len();
    let tag = format!("\"{tag}\"");
    let known = asked.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let is_known = known
        .flat_map(|list| list.split(','))
        .map(str::trim)
        .any(|known| known == "*" || known.strip_prefix("W/").unwrap_or(known) == tag);
    let mut headers = HeaderMap::new();
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    headers.insert(header::ETAG, HeaderValue::try_from(&tag).map_err(io::Error::other)?);
    if is_known {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    let mut put = |name, text: String| {
        headers.insert(name, HeaderValue::try_from(text).map_err(io::Error::other)?);
        io::Result::Ok(())
    };
    // A part of another content would spoil what the client has.
    let is_same = asked.get(header::IF_RANGE).is_none_or(|value| value.as_bytes() == tag.as_bytes());
    let part = if method == Method::GET && is_same { part(asked, length) } else { Part::Whole };
    let (status, range) = match part {
        Part::Whole => (StatusCode::OK, 0..length),
        Part::Of(range) => {
            put(header::CONTENT_RANGE, format!("bytes {}-{}/{length}", range.start, range.end - 1))?;
            (StatusCode::PARTIAL_CONTENT, range)
        }
        Part::Outside => {
            put(header::CONTENT_RANGE, format!("bytes */{length}"))?;
            return Ok((StatusCode::RANGE_NOT_SATISFIABLE, headers).into_response());
        }
    };
    let size = range.end - range.start;
    put(header::CONTENT_LENGTH, size.to_string())?;
    file.seek(SeekFrom::Start(range.start)).await?;
    let mut file = file.take(size);
    let body = if size <= BLOCK {
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).await?;
        // The file may have been cut since.
        if bytes.len() as u64 != size {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Body::from(bytes)
    } else {
        Body::from_stream(Blocks { file, block: vec![0; BLOCK as usize] })
    };
    Ok((status, headers, body).into_response())
}

/// The part of a file that a request asks for.
#[derive(Debug, PartialEq, Eq)]
enum Part {
    Whole,
    /// Not empty.
    Of(Range<u64>),
    Outside,
}

/// The part of a file of `length` bytes that the header `Range` names. One that cannot be read counts as none.
fn part(asked: &HeaderMap, length: u64) -> Part {
    let mut values = asked.get_all(header::RANGE).iter();
    let (Some(value), None) = (values.next(), values.next()) else { return Part::Whole };
    let range = value.to_str().ok().and_then(|text| {
        let (unit, range) = text.split_once('=')?;
        unit.trim().eq_ignore_ascii_case("bytes").then_some(range.trim())
    });
    let Some((first, last)) = range.and_then(|range| range.split_once('-')) else { return Part::Whole };
    // A number too large for the type is one beyond every file.
    let number = |text: &str| -> Option<u64> {
        let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        is_number.then(|| text.parse().unwrap_or(u64::MAX))
    };
    let range = match (first, number(first), last, number(last)) {
        ("", _, _, Some(count)) => length.saturating_sub(count)..length,
        (_, Some(first), "", _) => first..length,
        (_, Some(first), _, Some(last)) if first <= last => first..last.saturating_add(1).min(length),
        _ => return Part::Whole,
    };
    if range.start < range.end { Part::Of(range) } else { Part::Outside }
}

/// The blocks of a file, one in memory at a time.
struct Blocks {
    file: Take<File>,
    block: Vec<u8>,
}

impl Stream for Blocks {
    type Item = io::Result<Bytes>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { file, block } = self.get_mut();
        let mut buffer = ReadBuf::new(block);
        match Pin::new(file).poll_read(context, &mut buffer) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(Err(error)) => Poll::Ready(Some(Err(error))),
            Poll::Ready(Ok(())) if buffer.filled().is_empty() => Poll::Ready(None),
            Poll::Ready(Ok(())) => Poll::Ready(Some(Ok(Bytes::copy_from_slice(buffer.filled())))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_read_as_the_standard_says() {
        let cases = [
            ("bytes=0-99", Part::Of(0..100)),
            ("bytes=0-0", Part::Of(0..1)),
            ("Bytes=999-", Part::Of(999..1000)),
            ("bytes=990-2000", Part::Of(990..1000)),
            ("bytes=0-99999999999999999999999", Part::Of(0..1000)),
            ("bytes=-1", Part::Of(999..1000)),
            ("bytes=-5000", Part::Of(0..1000)),
            ("bytes=1000-", Part::Outside),
            ("bytes=99999999999999999999999-", Part::Outside),
            ("bytes=-0", Part::Outside),
            ("bytes=0-1,5-6", Part::Whole),
            ("bytes=5-4", Part::Whole),
            ("bytes=+1-4", Part::Whole),
            ("bytes=-", Part::Whole),
            ("bytes=", Part::Whole),
            ("rows=0-1", Part::Whole),
            ("0-1", Part::Whole),
        ];
        for (text, expected) in cases {
            let asked = HeaderMap::from_iter([(header::RANGE, HeaderValue::from_static(text))]);
            assert_eq!(part(&asked, 1000), expected, "{text}");
        }
        assert_eq!(part(&HeaderMap::new(), 1000), Part::Whole);
        let asked = HeaderMap::from_iter([(header::RANGE, HeaderValue::from_static("bytes=0-"))]);
        assert_eq!(part(&asked, 0), Part::Outside);
    }
}
