//! Escapes and shortens text for a page.

/// Escapes text from a bag for HTML text and quoted attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Control characters have no place in a page; direction marks could show a name backwards.
            c if c.is_control()
                || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}') =>
            {
                out.push('\u{fffd}');
            }
            c => out.push(c),
        }
    }
    out
}

pub(super) fn shell_word(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:@,=".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text.into() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

/// A path as the address of a link, percent-encoded where it could be read as a scheme or a query.
pub(super) fn link(path: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~/".contains(&byte);
    path.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

/// Bytes in base64, for the address of data.
pub(super) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits = (0..3).fold(0, |bits, at| bits << 8 | usize::from(three.get(at).copied().unwrap_or(0)));
        for at in 0..4 {
            out.push(if at <= three.len() { char::from(DIGITS[bits >> (18 - 6 * at) & 63]) } else { '=' });
        }
    }
    out
}

/// A name such as `old_bulb_held` with spaces for underscores.
pub(super) fn words(name: &str) -> String {
    escape(&name.replace('_', " "))
}

/// The part of a class name for the cause of an end: the style has `b-fall` for a background and `f-fall` for a figure.
pub fn cause_class(cause: &str) -> &'static str {
    match cause {
        "success" => "success",
        "diverged" => "diverged",
        "fall" => "fall",
        "tip" => "tip",
        "crush" => "crush",
        "drop" => "drop",
        "unseated" => "unseated",
        "impact" => "impact",
        "time-out" => "timeout",
        _ => "other",
    }
}

/// A coordinate, rounded to a screen's resolution.
pub(super) fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// A share from 0 to 1, like all such numbers of the page.
pub(super) fn share(share: f64) -> String {
    format!("{share:.2}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_a_bag_is_markup() {
        assert_eq!(
            escape("<script>\"a\" & 'b'</script>"),
            "&lt;script&gt;&quot;a&quot; &amp; &#39;b&#39;&lt;/script&gt;"
        );
        assert_eq!(escape("a\u{202e}b\0"), "a\u{fffd}b\u{fffd}");
        assert_eq!(shell_word("runs/zero"), "runs/zero");
        assert_eq!(shell_word("a'; rm x"), "'a'\\''; rm x'");
    }

    #[test]
    fn a_path_is_no_scheme_in_a_link() {
        assert_eq!(link("../bags/S05-s0-e0.html"), "../bags/S05-s0-e0.html");
        assert_eq!(link("javascript:a?b#c\"d e.html"), "javascript%3Aa%3Fb%23c%22d%20e.html");
    }

    #[test]
    fn coordinates_are_short() {
        assert_eq!((px(1.0), px(1.25), px(-0.04)), ("1".into(), "1.2".into(), "-0".into()));
    }
}
