//! Content-addressed files: each is named by the SHA-256 of its bytes, so it is written once and never changes.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use data_encoding::HEXLOWER;
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{MultipartUpload as _, ObjectStore, ObjectStoreExt as _, PutPayload};
use sha2::{Digest as _, Sha256};

use super::bucket;
use crate::StoreError;

/// Size of the blocks in which files are read and written, bytes.
const BLOCK: usize = 1 << 20;
/// Size of the parts that a bucket gets: S3 takes none below 5 MiB but the last.
const PART: usize = 8 << 20;
/// Maximum size of the copies of a bucket's files on this machine, bytes. Those in use within [`IN_USE`] are kept beyond it.
const MAX_COPIES: u64 = 16 << 30;
const IN_USE: Duration = Duration::from_secs(600);

/// SHA-256 of a file: 64 hexadecimal digits in lower case.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Digest(String);

impl Digest {
    /// Reads 64 hexadecimal digits in lower case; `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        (text.len() == 64 && text.bytes().all(is_digit)).then(|| Self(text.to_owned()))
    }

    pub fn of(bytes: &[u8]) -> Self {
        Self::from(Sha256::new().chain_update(bytes))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn key(&self) -> Key {
        Key::from(format!("{}/{}", &self.0[..2], self.0))
    }
}

impl From<Sha256> for Digest {
    fn from(sum: Sha256) -> Self {
        Self(HEXLOWER.encode(&sum.finalize()))
    }
}

/// The place of the files: a folder, or `s3://BUCKET/PREFIX`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FilesUrl {
    Folder(PathBuf),
    S3 { bucket: String, prefix: String },
}

impl FromStr for FilesUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((scheme, rest)) = text.split_once("://") else {
            return if text.is_empty() {
                Err("name a folder, or s3://BUCKET/PREFIX".into())
            } else {
                Ok(Self::Folder(text.into()))
            };
        };
        if scheme != "s3" {
            return Err(format!("files are kept in a folder or in s3://BUCKET/PREFIX, not in {scheme}://"));
        }
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let prefix = prefix.trim_matches('/');
        let is_word = |text: &str| text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
        let is_prefix =
            prefix.is_empty() || prefix.split('/').all(|part| !part.is_empty() && is_word(part) && part != "..");
        if bucket.is_empty() || !is_word(bucket) || !is_prefix {
            return Err("write s3://BUCKET/PREFIX with letters, digits, -, _ and . alone".into());
        }
        Ok(Self::S3 { bucket: bucket.into(), prefix: prefix.into() })
    }
}

impl std::fmt::Display for FilesUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Folder(folder) => write!(f, "{}", folder.display()),
            Self::S3 { bucket, prefix } => write!(f, "s3://{bucket}/{prefix}"),
        }
    }
}

/// The store of files. Everything goes through [`ObjectStore`] except [`Blobs::local`], which readers of bags need.
#[derive(Debug, Clone)]
pub(crate) struct Blobs {
    store: Arc<dyn ObjectStore>,
    /// The folder of the files themselves, or of copies of some.
    root: PathBuf,
    /// For a bucket: bytes copied since the copies were last counted.
    copied: Option<Arc<AtomicU64>>,
}

impl Blobs {
    /// Opens the files. `copies` is a folder for copies of a bucket's files.
    pub async fn open(url: &FilesUrl, copies: &Path) -> Result<Self, StoreError> {
        let failed = |error| StoreError::blobs("be opened")(error);
        let root = if let FilesUrl::Folder(folder) = url { folder } else { copies };
        std::fs::create_dir_all(root).map_err(StoreError::io("make", root))?;
        match url {
            FilesUrl::Folder(_) => {
                let store = LocalFileSystem::new_with_prefix(root).map_err(failed)?.with_fsync(true);
                Ok(Self { store: Arc::new(store), root: root.into(), copied: None })
            }
            FilesUrl::S3 { bucket, prefix } => {
                let text = |text: std::ffi::OsString| text.into_string().ok();
                let variables = std::env::vars_os().filter_map(|(name, value)| Some((text(name)?, text(value)?)));
                let store = bucket::open(bucket, prefix, variables).map_err(failed)?;
                Self::of_bucket(store, root).await
            }
        }
    }

    async fn of_bucket(store: Arc<dyn ObjectStore>, copies: &Path) -> Result<Self, StoreError> {
        let blobs = Self { store, root: copies.into(), copied: Some(Arc::default()) };
        // A wrong bucket or key is told now, and not to the first who submits.
        blobs.has(&Digest::of(b"")).await?;
        Ok(blobs)
    }

    pub async fn put(&self, bytes: Vec<u8>) -> Result<Digest, StoreError> {
        let digest = Digest::of(&bytes);
        if !self.has(&digest).await? {
            let payload = PutPayload::from(bytes);
            self.store.put(&digest.key(), payload).await.map_err(StoreError::blobs("take a file"))?;
        }
        Ok(digest)
    }

    /// Stores a copy of a file if it has this digest; else stores nothing and returns `false`.
    pub async fn put_checked(&self, digest: &Digest, file: &Path) -> Result<bool, StoreError> {
        let failed = |error| StoreError::blobs("take a file")(error);
        let size = file.metadata().map_err(StoreError::io("read", file))?.len();
        if self.copied.is_some() && size <= PART as u64 {
            // One request in place of three.
            let bytes = tokio::fs::read(file).await.map_err(StoreError::io("read", file))?;
            let read = tokio::task::spawn_blocking(move || (Digest::of(&bytes), bytes)).await;
            let (found, bytes) = read.map_err(|_| StoreError::corrupt("a file", "a thread ended early"))?;
            let is_it = found == *digest;
            if is_it {
                self.store.put(&digest.key(), PutPayload::from(bytes)).await.map_err(failed)?;
            }
            return Ok(is_it);
        }
        let block = if self.copied.is_some() { PART } else { BLOCK };
        let mut upload = self.store.put_multipart(&digest.key()).await.map_err(failed)?;
        let copied = async {
            let file_in = File::open(file).map_err(StoreError::io("open", file))?;
            let mut source = DigestReader { file: file_in, sum: Sha256::new(), block };
            loop {
                // Milliseconds for each block: not on a thread that answers requests.
                let next = tokio::task::spawn_blocking(move || source.next().map(|block| (block, source)));
                let next = next.await.map_err(|_| StoreError::corrupt("a file", "a thread ended early"))?;
                let (block, rest) = next.map_err(StoreError::io("read", file))?;
                if block.is_empty() {
                    return Ok(Digest::from(rest.sum));
                }
                source = rest;
                upload.put_part(PutPayload::from(block)).await.map_err(failed)?;
            }
        };
        let copied: Result<Digest, StoreError> = copied.await;
        let is_it = copied.as_ref().is_ok_and(|found| found == digest);
        if is_it {
            upload.complete().await.map_err(failed)?;
        } else if let Err(error) = upload.abort().await {
            tracing::warn!(%error, "cannot remove the parts of a file that was not kept");
        }
        copied.map(|_| is_it)
    }

    pub async fn has(&self, digest: &Digest) -> Result<bool, StoreError> {
        match self.store.head(&digest.key()).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(StoreError::blobs("look for a file")(error)),
        }
    }

    pub async fn read(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        let failed = |error| StoreError::blobs("read a file")(error);
        let found = self.store.get(&digest.key()).await.map_err(failed)?;
        Ok(found.bytes().await.map_err(failed)?.into())
    }

    /// Removes a file; a missing one is not an error.
    pub async fn remove(&self, digest: &Digest) -> Result<(), StoreError> {
        if self.copied.is_some() {
            drop(tokio::fs::remove_file(self.path(digest)).await);
        }
        match self.store.delete(&digest.key()).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::blobs("remove a file")(error)),
        }
    }

    /// Removes partial files of uploads that were cut off with their service, `DIGEST#NUMBER`, which nobody reads.
    /// Returns their number. Nothing may write meanwhile.
    pub async fn remove_staged(&self) -> Result<usize, StoreError> {
        let root = self.root.clone();
        let removed = tokio::task::spawn_blocking(move || {
            let mut removed = 0;
            for folder in listed(&root)?.into_iter().filter(|path| path.is_dir()) {
                for file in listed(&folder)?.into_iter().filter(|path| is_staged(path)) {
                    std::fs::remove_file(&file).map_err(StoreError::io("remove", &file))?;
                    removed += 1;
                }
            }
            Ok(removed)
        });
        removed.await.map_err(|_| StoreError::corrupt("the folder of the bags", "a thread ended early"))?
    }

    fn path(&self, digest: &Digest) -> PathBuf {
        self.root.join(&digest.0[..2]).join(&digest.0)
    }

    /// The path of a file on this machine. One of a bucket is copied first, and its content checked; the copy stays for some minutes at
    /// least.
    pub async fn local(&self, digest: &Digest) -> Result<PathBuf, StoreError> {
        let path = self.path(digest);
        let Some(copied) = &self.copied else { return Ok(path) };
        if let Ok(file) = File::options().append(true).open(&path) {
            // The time of its last use.
            drop(file.set_modified(SystemTime::now()));
            return Ok(path);
        }
        let bytes = self.read(digest).await?;
        let size = bytes.len() as u64;
        let (root, digest, to) = (self.root.clone(), digest.clone(), path.clone());
        let is_full = copied.fetch_add(size, Ordering::Relaxed) + size > MAX_COPIES / 16;
        if is_full {
            copied.store(0, Ordering::Relaxed);
        }
        let made = tokio::task::spawn_blocking(move || {
            if Digest::of(&bytes) != digest {
                return Err(StoreError::corrupt(
                    format!("the file {}", digest.0),
                    "its content does not match its name",
                ));
            }
            if is_full {
                remove_old(&root, MAX_COPIES)?;
            }
            let folder = to.parent().unwrap_or(&root);
            std::fs::create_dir_all(folder).map_err(StoreError::io("make", folder))?;
            // Several may copy it at once, each to a name of its own.
            let mut random = [0; 8];
            getrandom::fill(&mut random).map_err(StoreError::Random)?;
            let part = folder.join(format!("{}#{}", digest.0, u64::from_le_bytes(random)));
            let written = std::fs::write(&part, &bytes).and_then(|()| std::fs::rename(&part, &to));
            written.map_err(|source| {
                drop(std::fs::remove_file(&part));
                StoreError::io("write", &to)(source)
            })
        });
        made.await.map_err(|_| StoreError::corrupt("a file", "a thread ended early"))??;
        Ok(path)
    }
}

/// Removes the copies that were used longest ago until the others have at most so many bytes.
fn remove_old(root: &Path, most: u64) -> Result<(), StoreError> {
    let mut files = Vec::new();
    for folder in listed(root)?.into_iter().filter(|path| path.is_dir()) {
        for path in listed(&folder)? {
            // Another one may have removed it.
            let Ok(data) = path.metadata() else { continue };
            files.push((data.modified().unwrap_or(SystemTime::UNIX_EPOCH), data.len(), path));
        }
    }
    files.sort();
    let mut whole: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
    for (used, bytes, path) in files {
        if whole <= most || used.elapsed().unwrap_or_default() < IN_USE {
            break;
        }
        drop(std::fs::remove_file(path));
        whole -= bytes;
    }
    Ok(())
}

/// A file, and the digest of the part that was read.
struct DigestReader {
    file: File,
    sum: Sha256,
    /// Size of a block, bytes.
    block: usize,
}

impl DigestReader {
    /// The next block; an empty one at the end.
    fn next(&mut self) -> std::io::Result<Vec<u8>> {
        let mut block = Vec::with_capacity(self.block);
        (&mut self.file).take(self.block as u64).read_to_end(&mut block)?;
        self.sum.update(&block);
        Ok(block)
    }
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let entries = std::fs::read_dir(folder).map_err(StoreError::io("read", folder))?;
    entries.map(|entry| Ok(entry.map_err(StoreError::io("read", folder))?.path())).collect()
}

/// True if a file has the name under which the store writes a content before it is complete.
fn is_staged(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.split_once('#'));
    name.is_some_and(|(digest, number)| {
        Digest::parse(digest).is_some() && !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Guards that the library's partial files are found by their names, and complete ones left alone.
    #[tokio::test]
    async fn what_a_kill_leaves_is_removed() {
        let root = std::env::temp_dir().join(format!("fiatlux-blobs-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&root));
        let blobs = Blobs::open(&FilesUrl::Folder(root.clone()), &root).await.unwrap();
        let whole = blobs.put(b"whole".to_vec()).await.unwrap();
        let mut upload = blobs.store.put_multipart(&Digest::of(b"half").key()).await.unwrap();
        upload.put_part(PutPayload::from(b"ha".to_vec())).await.unwrap();
        // As a kill would: nothing is tidied up.
        std::mem::forget(upload);
        assert_eq!(blobs.remove_staged().await.unwrap(), 1);
        assert_eq!(blobs.remove_staged().await.unwrap(), 0);
        assert_eq!(blobs.read(&whole).await.unwrap(), b"whole");
        std::fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn addresses_of_files() {
        let read = |text: &str| text.parse::<FilesUrl>();
        let s3 = |bucket: &str, prefix: &str| FilesUrl::S3 { bucket: bucket.into(), prefix: prefix.into() };
        assert_eq!(read("/srv/bags").unwrap(), FilesUrl::Folder("/srv/bags".into()));
        assert_eq!(read("s3://bags").unwrap(), s3("bags", ""));
        assert_eq!(read("s3://my.bags/board/1/").unwrap(), s3("my.bags", "board/1"));
        for wrong in [
            "",
            "s3://",
            "s3:///a",
            "s3://a/../b",
            "s3://a/b//c",
            "s3://a?b",
            "s3://key:secret@a/b",
            "gs://a/b",
            "https://a/b",
        ] {
            let refused = read(wrong).unwrap_err();
            assert!(!refused.contains("secret"), "{wrong}: {refused}");
        }
    }

    /// Guards files in a bucket: they are the same as in a folder, what arrives is checked on the way in and out, and copies outlive the server.
    #[tokio::test]
    async fn a_bucket_keeps_files() {
        let server = crate::stores::Server::start("bags");
        let root = std::env::temp_dir().join(format!("fiatlux-bucket-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&root));
        std::fs::create_dir_all(&root).unwrap();
        let open = |variables: Vec<(String, String)>| bucket::open("bags", "board", variables).unwrap();
        let variables: Vec<_> = server.environment().map(|(name, value)| (name.to_owned(), value)).into();
        let blobs = Blobs::of_bucket(open(variables.clone()), &root.join("copies")).await.unwrap();

        let small = blobs.put(b"small".to_vec()).await.unwrap();
        assert_eq!(blobs.read(&small).await.unwrap(), b"small");
        // More than two parts, of which the last is small; and an empty file.
        let large: Vec<u8> = (0..2 * PART + 7).map(|number| (number % 251) as u8).collect();
        for content in [&large[..], &large[..PART], b"x", b""] {
            let (digest, file) = (Digest::of(content), root.join("file"));
            std::fs::write(&file, content).unwrap();
            assert!(!blobs.put_checked(&Digest::of(b"another"), &file).await.unwrap());
            assert!(!blobs.has(&Digest::of(b"another")).await.unwrap() && !blobs.has(&digest).await.unwrap());
            assert!(blobs.put_checked(&digest, &file).await.unwrap() && blobs.has(&digest).await.unwrap());
            assert!(server.objects()[&format!("board/{}/{}", &digest.as_str()[..2], digest.as_str())] == content);
            let copy = blobs.local(&digest).await.unwrap();
            assert!(std::fs::read(&copy).unwrap() == content);
        }
        // Somebody changes an object, or takes it away.
        let key = format!("board/{}/{}", &small.as_str()[..2], small.as_str());
        server.set(&key, b"other");
        let corrupt = blobs.local(&small).await.unwrap_err().to_string();
        assert!(corrupt.contains(small.as_str()) && corrupt.contains("does not match its name"), "{corrupt}");
        server.set(&key, b"small");
        let copy = blobs.local(&small).await.unwrap();
        server.set_away(true);
        assert_eq!(blobs.local(&small).await.unwrap(), copy);
        assert!(matches!(blobs.read(&small).await, Err(StoreError::Blobs { .. })));
        server.set_away(false);
        blobs.remove(&small).await.unwrap();
        blobs.remove(&small).await.unwrap();
        assert!(!blobs.has(&small).await.unwrap() && !copy.exists());
        assert!(blobs.local(&small).await.is_err());

        // A wrong key is told at the start.
        let wrong = variables.into_iter().map(|(name, value)| {
            let value = if name == "AWS_SECRET_ACCESS_KEY" { "wrong".into() } else { value };
            (name, value)
        });
        let refused = Blobs::of_bucket(open(wrong.collect()), &root.join("copies")).await;
        assert!(matches!(refused, Err(StoreError::Blobs { .. })), "{refused:?}");
        std::fs::remove_dir_all(&root).unwrap();
    }

    /// Guards the disk of a scorer: copies of a bucket's files that nobody has used for long go first, and those in use stay.
    #[test]
    fn old_copies_go() {
        let root = std::env::temp_dir().join(format!("fiatlux-copies-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&root));
        let copy = |name: &str, age: u64| {
            let folder = root.join(&name[..1]);
            std::fs::create_dir_all(&folder).unwrap();
            let path = folder.join(name);
            std::fs::write(&path, [0; 100]).unwrap();
            let used = SystemTime::now() - Duration::from_secs(age);
            File::options().append(true).open(&path).unwrap().set_modified(used).unwrap();
            path
        };
        let [old, older, oldest, used] = [copy("a1", 5_000), copy("b1", 6_000), copy("b2", 7_000), copy("a2", 1)];
        remove_old(&root, 250).unwrap();
        assert_eq!([&old, &older, &oldest, &used].map(|path| path.exists()), [true, false, false, true]);
        remove_old(&root, 0).unwrap();
        assert_eq!([&old, &used].map(|path| path.exists()), [false, true]);
        std::fs::remove_dir_all(&root).unwrap();
    }
}
