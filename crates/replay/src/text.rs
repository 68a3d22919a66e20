//! Prepares text from a bag for display.

use fiatlux_proto::is_unseen;

const MAX_CHARS: usize = 300;

/// Shortens a text from a bag, and removes control characters and marks that change its direction.
pub(crate) fn short(text: &str) -> String {
    let shown = |c: char| if is_unseen(c) { '\u{fffd}' } else { c };
    let mut out: String = text.chars().take(MAX_CHARS).map(shown).collect();
    if text.chars().nth(MAX_CHARS).is_some() {
        out.push('\u{2026}');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn hostile_text_is_bounded_and_cannot_turn_a_line() {
        assert_eq!(short("walk"), "walk");
        assert_eq!(short("a\u{202e}b\nc"), "a\u{fffd}b\u{fffd}c");
        assert_eq!(short(&"x".repeat(10_000)).chars().count(), 301);
    }
}
