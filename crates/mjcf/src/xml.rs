//! XML with indented lines.

use std::fmt::Display;

/// Name and value.
pub(crate) type Attribute<'a> = (&'a str, &'a dyn Display);

/// Writes XML with indented lines.
#[derive(Default)]
pub(crate) struct Xml {
    pub out: String,
    depth: usize,
}

impl Xml {
    pub fn open(&mut self, tag: &str, attributes: &[Attribute]) {
        self.element(tag, attributes, ">");
        self.depth += 1;
    }

    pub fn leaf(&mut self, tag: &str, attributes: &[Attribute]) {
        self.element(tag, attributes, "/>");
    }

    pub fn close(&mut self, tag: &str) {
        self.depth -= 1;
        self.out += &format!("{}</{tag}>\n", "  ".repeat(self.depth));
    }

    fn element(&mut self, tag: &str, attributes: &[Attribute], end: &str) {
        self.out += &"  ".repeat(self.depth);
        self.out += &format!("<{tag}");
        for (name, value) in attributes {
            self.out += &format!(" {name}=\"{}\"", escape(&value.to_string()));
        }
        self.out += end;
        self.out.push('\n');
    }
}

fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\n' | '\r' | '\t' => out += &format!("&#{};", u32::from(c)),
            _ => out.push(c),
        }
    }
    out
}
