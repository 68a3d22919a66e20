//! Text from strangers: what of it may be shown as it is.

use std::borrow::Cow;
use std::fmt::{Display, Write as _};

/// Characters that change how the text around them is shown: controls such as ESC and line breaks, and those of Unicode that
/// change its direction or have no width.
pub fn is_unseen(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

/// A stranger's text for a terminal or a log, on one line: [unseen](is_unseen) characters are escaped as in JSON.
///
/// ```
/// assert_eq!(fiatlux_proto::plain("walk\n\x1b[2Kequal"), r"walk\u000a\u001b[2Kequal");
/// ```
pub fn plain(text: &str) -> Cow<'_, str> {
    escaped(text, is_unseen)
}

/// As [`plain`], for our own text in which a stranger's may stand: its line breaks and tabs stay, and JSON stays JSON.
pub fn plain_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| !matches!(c, '\n' | '\t') && is_unseen(c))
}

/// A count with its noun, in the plural unless it is 1.
///
/// ```
/// assert_eq!(fiatlux_proto::count(1, "bag") + " and " + &fiatlux_proto::count(2, "bag"), "1 bag and 2 bags");
/// ```
pub fn count<N: Display + PartialEq + From<u8>>(n: N, noun: &str) -> String {
    let s = if n == 1.into() { "" } else { "s" };
    format!("{n} {noun}{s}")
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        // Writing to a string cannot fail.
        let _ = if is_escaped(c) { write!(out, "\\u{:04x}", u32::from(c)) } else { write!(out, "{c}") };
    }
    out.into()
}
