//! The files from outside: they read back, are guarded, and are refused with the line that is wrong.
#![allow(clippy::unwrap_used)]

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use fiatlux_access::{AccessError, Grant, Identity, KnownServers, PublicKey, RecorderKey, Token, Tokens};

struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("fiatlux-access-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a file that only its owner can read.
    fn secret(&self, name: &str, text: &str) -> PathBuf {
        let path = self.file(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(fs::remove_dir_all(&self.0));
    }
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// RFC 8032, section 7.1, test 3: guards that the signature is standard Ed25519.
#[test]
fn signs_as_the_standard_says() {
    let folder = Folder::new();
    let path = folder.secret("identity", "fiatlux-identity:xaqN9D+fg3vtt0QvMdy3sWbThTUHbwlLhc46LgtEWPc=\n");
    let identity = Identity::read(&path).unwrap();
    let public: PublicKey = "ed25519:/FHNjmIYoaONpH7QAjDwWAgW7RO6MwOsXeuRFUiQgCU=".parse().unwrap();
    assert_eq!(identity.public(), public);
    let signature = identity.sign(&[0xaf, 0x82]);
    assert_eq!(signature[..8], [0x62, 0x91, 0xd6, 0x57, 0xde, 0xec, 0x24, 0x02]);
    assert!(public.verify(&[0xaf, 0x82], &signature));
    assert!(!public.verify(&[0xaf, 0x83], &signature) && !public.verify(&[0xaf, 0x82], &signature[..63]));
    assert!(!Identity::generate().unwrap().public().verify(&[0xaf, 0x82], &signature));
    assert!(!format!("{identity:?}").contains("xaqN"), "a log must not show the secret");
}

#[test]
fn what_is_written_reads_back() {
    let folder = Folder::new();
    let identity = Identity::generate().unwrap();
    identity.write(&folder.file("identity")).unwrap();
    assert_eq!(Identity::read(&folder.file("identity")).unwrap().public(), identity.public());
    assert_eq!(identity.public().to_string().parse(), Ok(identity.public()));
    let key = RecorderKey::generate().unwrap();
    key.write(&folder.file("recorder")).unwrap();
    assert_eq!(RecorderKey::read(&folder.file("recorder")).unwrap().as_bytes(), key.as_bytes());
    let token = Token::generate("lab-2").unwrap();
    token.write(&folder.file("token")).unwrap();
    let back = Token::read(&folder.file("token")).unwrap();
    assert_eq!((back.id(), back.secret()), ("lab-2", token.secret()));
    let tokens: Tokens = [Grant::new(token.clone(), 3)].into_iter().collect();
    tokens.write(&folder.file("tokens")).unwrap();
    let tokens = Tokens::read(&folder.file("tokens")).unwrap();
    assert_eq!(tokens.check(&token).map(Grant::limit), Some(3));
    assert!(tokens.check(&Token::generate("lab-2").unwrap()).is_none(), "another secret");
    assert!(tokens.check(&Token::generate("lab").unwrap()).is_none() && tokens.of("lab").is_none(), "another id");
    for name in ["identity", "recorder", "token", "tokens"] {
        assert_eq!(mode(&folder.file(name)), 0o600, "{name}");
    }
}

#[test]
fn nothing_is_overwritten() {
    let folder = Folder::new();
    let path = folder.file("key");
    RecorderKey::generate().unwrap().write(&path).unwrap();
    let before = fs::read(&path).unwrap();
    let token = Token::generate("a").unwrap();
    let attempts = [
        Identity::generate().unwrap().write(&path),
        RecorderKey::generate().unwrap().write(&path),
        token.write(&path),
        Tokens::default().write(&path),
    ];
    for attempt in attempts {
        assert!(matches!(attempt, Err(AccessError::Exists { .. })), "{attempt:?}");
    }
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn a_secret_that_others_can_read_is_refused() {
    let folder = Folder::new();
    let (identity, recorder) = (folder.file("identity"), folder.file("recorder"));
    let (token, tokens) = (folder.file("token"), folder.file("tokens"));
    Identity::generate().unwrap().write(&identity).unwrap();
    RecorderKey::generate().unwrap().write(&recorder).unwrap();
    Token::generate("a").unwrap().write(&token).unwrap();
    Tokens::default().write(&tokens).unwrap();
    for bits in [0o660, 0o604, 0o620, 0o644] {
        for path in [&identity, &recorder, &token, &tokens] {
            fs::set_permissions(path, Permissions::from_mode(bits)).unwrap();
        }
        let errors = [
            Identity::read(&identity).err(),
            RecorderKey::read(&recorder).err(),
            Token::read(&token).err(),
            Tokens::read(&tokens).err(),
        ];
        for error in errors {
            let message = error.unwrap().to_string();
            assert!(message.contains(&format!("mode {bits:04o}")) && message.contains("chmod 600"), "{message}");
        }
    }
}

/// Guards that whoever names the wrong file is not told to hide a public one.
#[test]
fn a_file_of_another_kind_is_refused_as_such_whatever_its_mode() {
    let folder = Folder::new();
    let path = folder.secret("known_servers", &KnownServers::line("lab", &Identity::generate().unwrap().public()));
    fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
    let message = Token::read(&path).unwrap_err().to_string();
    assert!(message.contains("a token is one line, ID:SECRET") && !message.contains("mode"), "{message}");
}

#[test]
fn a_wrong_line_is_named_without_its_secret() {
    let folder = Folder::new();
    let hex = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";
    let key = Identity::generate().unwrap().public().to_string();
    let wrong = "ed25519:QUJD";
    type Read = fn(&Path) -> Option<AccessError>;
    let identity: Read = |path| Identity::read(path).err();
    let recorder: Read = |path| RecorderKey::read(path).err();
    let known: Read = |path| KnownServers::read(path).err();
    let token: Read = |path| Token::read(path).err();
    let tokens: Read = |path| Tokens::read(path).err();
    let cases = [
        (identity, String::new(), ":1: identity: the file is empty"),
        (identity, "fiatlux-recorder:AAAA".into(), ":1: identity: it does not begin with 'fiatlux-identity:'"),
        (identity, "fiatlux-identity:AAAA".into(), "it has 3 bytes, not 32"),
        (identity, "# mine\nfiatlux-identity:!!".into(), ":2: identity: it is not base64"),
        (recorder, "fiatlux-recorder:AAAA\nx".into(), ":2: recorder key: the file has a second line"),
        (known, format!("a {key}\n\n# b\na {key}"), ":4: NAME: 'a' is in an earlier line"),
        (known, format!("a/b {key}"), ":1: NAME: 'a/b' cannot be a server's name"),
        (known, "a".into(), ":1: public key: it is missing"),
        (known, format!("a {wrong}"), ":1: public key: it has 3 bytes, not 32"),
        (known, format!("a {key} b"), ":1: line: it has a third word"),
        (token, "lab".into(), ":1: token: it has no colon"),
        (token, format!("l b:{hex}"), ":1: token: it does not begin with an ID; a token is one line, ID:SECRET"),
        (token, "lab:12".into(), ":1: SECRET: it is not 64 hexadecimal digits"),
        (token, format!("lab:{}é", &hex[2..]), ":1: SECRET: it is not 64 hexadecimal digits"),
        (tokens, format!("a {hex} 1\nb {hex}"), ":2: line: it has 2 words, not 3"),
        (tokens, format!("a {hex} 1\na {hex} 1"), ":2: ID: 'a' is in an earlier line"),
        (tokens, format!("a {hex} 0"), ":1: LIMIT: "),
        (tokens, format!("a {hex} -1"), ":1: LIMIT: "),
        (tokens, format!("a {hex} 65537"), ":1: LIMIT: "),
        (tokens, format!("a {}zz 1", &hex[2..]), ":1: SECRET: "),
    ];
    for (index, (read, text, words)) in cases.into_iter().enumerate() {
        let path = folder.secret(&format!("{index}"), &text);
        let message = read(&path).unwrap_or_else(|| panic!("'{text}' was read")).to_string();
        assert!(message.starts_with(&path.display().to_string()) && message.contains(words), "{text}: {message}");
        assert!(!message.contains(&hex[2..20]), "a secret shows: {message}");
    }
    let message = Tokens::read(&folder.file("none")).unwrap_err().to_string();
    assert!(message.contains("none") && message.contains("fiatlux keys"), "{message}");
}

#[test]
fn known_servers_have_their_keys() {
    let folder = Folder::new();
    let (one, two) = (Identity::generate().unwrap().public(), Identity::generate().unwrap().public());
    let path = folder.file("known");
    let text = format!("# ours\n{}  lab-2\t{two}  # in the basement\n", KnownServers::line("lab", &one));
    fs::write(&path, text).unwrap();
    let known = KnownServers::read(&path).unwrap();
    assert_eq!((known.key_of("lab"), known.key_of("lab-2"), known.key_of("x")), (Some(one), Some(two), None));
    assert_eq!(known.names().collect::<Vec<_>>(), ["lab", "lab-2"]);
}
