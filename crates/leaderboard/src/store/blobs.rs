//! Content-addressed files: each is named by the SHA-256 of its bytes, so it is written once and never changes.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use data_encoding::HEXLOWER;
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{MultipartUpload as _, ObjectStore, ObjectStoreExt as _, PutPayload};
use sha2::{Digest as _, Sha256};

use crate::StoreError;

/// Size of the blocks in which files are read and written, bytes.
const BLOCK: usize = 1 << 20;

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

/// The store of files. Everything goes through [`ObjectStore`] except [`Blobs::local`], which readers of bags need; for
/// a store on another host it would have to fetch the file first.
#[derive(Debug, Clone)]
pub(crate) struct Blobs {
    store: Arc<dyn ObjectStore>,
    root: PathBuf,
}

impl Blobs {
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        std::fs::create_dir_all(root).map_err(StoreError::io("make", root))?;
        let store = LocalFileSystem::new_with_prefix(root).map_err(StoreError::blobs("be opened"))?.with_fsync(true);
        Ok(Self { store: Arc::new(store), root: root.into() })
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
        let mut upload = self.store.put_multipart(&digest.key()).await.map_err(failed)?;
        let copied = async {
            let mut source =
                DigestReader { file: File::open(file).map_err(StoreError::io("open", file))?, sum: Sha256::new() };
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

    pub fn local(&self, digest: &Digest) -> PathBuf {
        self.root.join(&digest.0[..2]).join(&digest.0)
    }
}

/// A file, and the digest of the part that was read.
struct DigestReader {
    file: File,
    sum: Sha256,
}

impl DigestReader {
    /// The next block; an empty one at the end.
    fn next(&mut self) -> std::io::Result<Vec<u8>> {
        let mut block = Vec::with_capacity(BLOCK);
        (&mut self.file).take(BLOCK as u64).read_to_end(&mut block)?;
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
        let blobs = Blobs::open(&root).unwrap();
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
}
