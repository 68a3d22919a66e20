//! Opens pages.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Asks the system to open an address; false where there is no screen, or nothing that can open it.
///
/// Other users of the machine can read the address: see [`open_browser_secretly`] for one with a secret.
pub fn open_browser(address: &str) -> bool {
    let has_screen = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    let opener = match std::env::consts::OS {
        "macos" => "open",
        _ if has_screen => "xdg-open",
        _ => return false,
    };
    let mut command = Command::new(opener);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().is_ok()
}

/// As [`open_browser`], for an address with a secret: the browser is given a file that leads to it, which only this user can read, so
/// that the secret is in the arguments of no process. The file is removed when the value that is returned is dropped.
pub fn open_browser_secretly(address: &str) -> Option<Redirect> {
    // Not in a hidden folder, nor in that for temporary files: browsers in a sandbox (snap) read neither.
    let redirect = Redirect::new(&std::env::home_dir()?, address)?;
    open_browser(&redirect.address()?).then_some(redirect)
}

/// A file that leads a browser to an address.
#[derive(Debug)]
pub struct Redirect {
    file: PathBuf,
}

impl Redirect {
    /// `None` where the folder takes no file.
    fn new(folder: &Path, address: &str) -> Option<Self> {
        let file = folder.join(format!("fiatlux-page-{}.html", std::process::id()));
        // One of an earlier process of this number, which was killed.
        drop(fs::remove_file(&file));
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut opened = options.open(&file).ok()?;
        let redirect = Self { file };
        let address = address.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
        let page = format!(
            "<!doctype html>\n<meta charset=\"utf-8\">\n<meta name=\"referrer\" content=\"no-referrer\">\n\
             <meta http-equiv=\"refresh\" content=\"0; url={address}\">\n<title>Fiatlux</title>\n\
             <p>This file leads to <a href=\"{address}\">the page</a>, and is removed when the program ends.</p>\n"
        );
        opened.write_all(page.as_bytes()).ok()?;
        Some(redirect)
    }

    /// Its address; `None` for a path that is no UTF-8.
    fn address(&self) -> Option<String> {
        let path = self.file.to_str()?;
        let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte);
        let encoded =
            path.bytes().map(|byte| if is_plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") });
        Some(format!("file://{}", encoded.collect::<String>()))
    }
}

impl Drop for Redirect {
    fn drop(&mut self) {
        drop(fs::remove_file(&self.file));
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn a_secret_address_is_in_a_file_of_its_user_and_in_no_argument() {
        let folder = std::env::temp_dir().join(format!("fiatlux open \u{e4}%{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let redirect = Redirect::new(&folder, "http://127.0.0.1:1/?token=5ec4e7&a=\"<").expect("a file");
        let address = redirect.address().expect("an address");
        assert!(address.starts_with("file:///") && !address.contains("5ec4e7"), "{address}");
        assert!(address.contains("fiatlux%20open%20%C3%A4%25"), "{address}");
        let metadata = fs::metadata(&redirect.file).expect("a file");
        assert_eq!(metadata.permissions().mode() & 0o777, 0o600);
        let text = fs::read_to_string(&redirect.file).expect("a text");
        assert!(text.contains("url=http://127.0.0.1:1/?token=5ec4e7&amp;a=&quot;&lt;\""), "{text}");
        let file = redirect.file.clone();
        drop(redirect);
        assert!(!file.exists());
        fs::remove_dir_all(folder).expect("removed");
    }
}
