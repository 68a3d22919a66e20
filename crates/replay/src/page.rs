//! The files of the page, and the HTML head that links them.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

use crate::packed::small;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Asset {
    pub name: &'static str,
    pub text: &'static str,
}

macro_rules! asset {
    ($folder:literal, $name:literal) => {
        Asset { name: $name, text: include_str!(concat!("../", $folder, "/", $name)) }
    };
}

pub(crate) const STYLE: Asset = asset!("page", "style.css");

/// JavaScript modules: ours, and those of three.js.
pub(crate) const MODULES: [Asset; 17] = [
    asset!("page", "arrows.js"),
    asset!("page", "bar.js"),
    asset!("page", "controls.js"),
    asset!("page", "data.js"),
    asset!("page", "list.js"),
    asset!("page", "look.js"),
    asset!("page", "main.js"),
    asset!("page", "pair.js"),
    asset!("page", "panel.js"),
    asset!("page", "pictures.js"),
    asset!("page", "player.js"),
    asset!("page", "plots.js"),
    asset!("page", "stage.js"),
    asset!("page", "words.js"),
    asset!("vendor/three", "OrbitControls.js"),
    asset!("vendor/three", "three.core.min.js"),
    asset!("vendor/three", "three.module.min.js"),
];

/// Names that modules import, and their files.
const NAMES: [(&str, &str); 2] =
    [("three", "three.module.min.js"), ("three/addons/controls/OrbitControls.js", "OrbitControls.js")];

const REPLAY: &str = include_str!("../page/replay.html");
/// Starts a page that is a file of its own.
const UNPACK: &str = include_str!("../page/unpack.js");
/// The parts of a page with replays, see [`crate::site`].
pub(crate) const ONE: &str = include_str!("../page/view.html");
pub(crate) const PAIR: &str = include_str!("../page/pair.html");
pub(crate) const LIST: &str = include_str!("../page/list.html");

/// Placeholder for the part that differs between a served page and a file.
const HEAD: &str = "<!--head-->";
const VIEW: &str = "<!--view-->";
const BACK: &str = "<!--back-->";
const DATA: &str = "<!--data-->";

/// An empty icon, so that browsers do not ask for one.
const ICON: &str = "<link rel=\"icon\" href=\"data:,\">\n";

/// A page from the server, with its Content-Security-Policy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Page {
    pub html: String,
    pub policy: String,
}

impl Page {
    pub fn list() -> Self {
        Self::served(LIST, "list.js", "")
    }

    /// The page of an episode; `is_listed` adds a link back to the list.
    pub fn replay(is_listed: bool) -> Self {
        let back = if is_listed { "<p class=\"small\"><a href=\"/\">All episodes</a></p>" } else { "" };
        Self::served(REPLAY, "main.js", back)
    }

    fn served(html: &str, module: &str, back: &str) -> Self {
        let Head { html: head, script } = Head::of(module);
        let policy = format!(
            "default-src 'none'; script-src 'self' {script}; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
             form-action 'none'; frame-ancestors 'none'",
        );
        Self { html: put_together(html, &format!("{ICON}{head}"), back, ""), policy }
    }
}

pub(crate) struct Head {
    /// Links to the style and the module, and the import map.
    pub html: String,
    /// Source for `script-src` in the page's policy, which allows the import map.
    pub script: String,
}

impl Head {
    /// The head of a page that starts with this module.
    pub fn of(module: &str) -> Self {
        let map = import_map(NAMES.map(|(name, file)| (name.to_owned(), format!("/page/{file}"))));
        let html = format!(
            "<link rel=\"stylesheet\" href=\"/page/{}\">\n<script type=\"importmap\">{map}</script>\n\
             <script type=\"module\" src=\"/page/{module}\"></script>",
            STYLE.name
        );
        Self { html, script: format!("'{}'", hash_of(&map)) }
    }
}

fn put_together(html: &str, head: &str, back: &str, data: &str) -> String {
    html.replace(HEAD, head).replace(VIEW, ONE.trim_end()).replace(BACK, back).replace(DATA, data)
}

/// The page of a replay as a single file with its data.
pub(crate) fn file(data: &str) -> String {
    let mut blocks = data.to_owned();
    for module in MODULES {
        let also = NAMES.iter().filter(|(_, file)| module.name == *file).map(|(name, _)| format!(" {name}"));
        let names = format!("{}{}", own_name(module.name), also.collect::<String>());
        let text = STANDARD.encode(small(by_name(module.text).as_bytes()));
        let _ = writeln!(blocks, "<script type=\"application/octet-stream\" data-names=\"{names}\">{text}</script>");
    }
    let _ = writeln!(blocks, "<script>{UNPACK}</script>");
    put_together(REPLAY, &standalone_head(), "", &blocks)
}

/// The head of a self-contained file: its policy allows nothing but its own scripts. The import map, which is only known once the modules
/// are unpacked, has a nonce; text from a bag stands in blocks of base64 and cannot use it.
fn standalone_head() -> String {
    let policy = format!(
        "default-src 'none'; script-src '{}' 'nonce-fiatlux' data:; style-src '{}'; img-src data:; base-uri 'none'; form-action 'none'",
        hash_of(UNPACK),
        hash_of(STYLE.text)
    );
    format!("<meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n{ICON}<style>{}</style>", STYLE.text)
}

/// Import name of a module inside a file, where relative addresses do not work.
fn own_name(file: &str) -> String {
    format!("fiatlux/{file}")
}

/// A module whose imports of neighbouring files are imports by name.
fn by_name(text: &str) -> String {
    let mut text = text.to_owned();
    for module in MODULES {
        for quote in ['"', '\''] {
            let (near, far) = (format!("{quote}./{}{quote}", module.name), own_name(module.name));
            text = text.replace(&near, &format!("{quote}{far}{quote}"));
        }
    }
    text
}

fn import_map(entries: impl IntoIterator<Item = (String, String)>) -> String {
    let mut map = String::from("{\"imports\":{");
    for (index, (name, address)) in entries.into_iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        let _ = write!(map, "{comma}\"{name}\":\"{address}\"");
    }
    map.push_str("}}");
    map
}

/// A source for a Content-Security-Policy that allows exactly this text.
fn hash_of(text: &str) -> String {
    format!("sha256-{}", STANDARD.encode(Sha256::digest(text)))
}

#[cfg(test)]
mod tests {
    use data_encoding::HEXLOWER;

    use super::*;

    /// Guards that three.js has the digests of the npm package `three` 0.180.0.
    #[test]
    fn three_is_what_npm_has() {
        let expected = [
            ("OrbitControls.js", "b97879c748170baadeb3fb84cea1ffdf4674e283dc06042f34e2acb95a76042c"),
            ("three.core.min.js", "61ba0df005b05991361d040d8ff670e1aadfd0ce7aeebd1fdb0725957a8957de"),
            ("three.module.min.js", "e2b5ee6bccd38fd6d8a2428546b83c5f2426d84b152ef82be8055556e3b40eb6"),
        ];
        for (name, digest) in expected {
            let module = MODULES.iter().find(|module| module.name == name).expect("a module");
            let found: String = HEXLOWER.encode(&Sha256::digest(module.text));
            assert_eq!(found, digest, "{name}");
        }
    }

    /// Guards that every import resolves: by a name of the map, or to a neighbouring file.
    #[test]
    fn imports_are_of_modules_that_are_here() {
        for module in MODULES {
            let imports = module.text.split("from").skip(1).filter_map(|rest| {
                let rest = rest.trim_start();
                let quote = rest.chars().next().filter(|c| ['"', '\''].contains(c))?;
                rest[1..].split(quote).next()
            });
            for import in imports.filter(|import| import.starts_with("./") || import.starts_with("three")) {
                let near = import.strip_prefix("./").is_some_and(|file| MODULES.iter().any(|m| m.name == file));
                assert!(near || NAMES.iter().any(|(name, _)| *name == import), "{}: {import}", module.name);
            }
        }
    }

    /// Guards that a self-contained file imports only by name: it has no neighbours.
    #[test]
    fn a_file_imports_by_name_alone() {
        for module in MODULES {
            let text = by_name(module.text);
            for neighbour in MODULES {
                assert!(!text.contains(&format!("./{}", neighbour.name)), "{} imports {}", module.name, neighbour.name);
            }
        }
    }
}
