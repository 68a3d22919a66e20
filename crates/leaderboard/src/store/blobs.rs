//! Content-addressed files: each is named by the SHA-256 of its bytes, so it is written once and never changes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{MultipartUpload as _, ObjectStore, ObjectStoreExt as _, PutPayload};
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncRead, AsyncReadExt as _};

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

    /// Computes the digest of some bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self::from(Sha256::new().chain_update(bytes))
    }

    /// The 64 hexadecimal digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn key(&self) -> Key {
        Key::from(format!("{}/{}", &self.0[..2], self.0))
    }
}

impl From<Sha256> for Digest {
    fn from(sum: Sha256) -> Self {
        Self(sum.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
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
    /// Opens or creates the store in a local folder.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        std::fs::create_dir_all(root).map_err(StoreError::io("make", root))?;
        let store = LocalFileSystem::new_with_prefix(root).map_err(StoreError::blobs("be opened"))?.with_fsync(true);
        Ok(Self { store: Arc::new(store), root: root.into() })
    }

    /// Stores bytes, and returns their digest.
    pub async fn put(&self, bytes: Vec<u8>) -> Result<Digest, StoreError> {
        let digest = Digest::of(&bytes);
        if !self.has(&digest).await? {
            let payload = PutPayload::from(bytes);
            self.store.put(&digest.key(), payload).await.map_err(StoreError::blobs("take a file"))?;
        }
        Ok(digest)
    }

    /// Stores what a reader yields if it has this digest; otherwise stores nothing and returns `false`.
    pub async fn put_checked(
        &self,
        digest: &Digest,
        reader: &mut (impl AsyncRead + Unpin),
        place: &Path,
    ) -> Result<bool, StoreError> {
        let failed = |error| StoreError::blobs("take a file")(error);
        let mut upload = self.store.put_multipart(&digest.key()).await.map_err(failed)?;
        let mut sum = Sha256::new();
        let copied = async {
            loop {
                let mut block = Vec::with_capacity(BLOCK);
                let read = reader.take(BLOCK as u64).read_to_end(&mut block).await;
                if read.map_err(StoreError::io("read", place))? == 0 {
                    return Ok(());
                }
                sum.update(&block);
                upload.put_part(PutPayload::from(block)).await.map_err(failed)?;
            }
        };
        let copied = copied.await;
        let is_it = copied.is_ok() && Digest::from(sum) == *digest;
        if is_it {
            upload.complete().await.map_err(failed)?;
        } else if let Err(error) = upload.abort().await {
            tracing::warn!(%error, "cannot remove the parts of a file that was not kept");
        }
        copied.map(|()| is_it)
    }

    /// Whether the store has a file of this digest.
    pub async fn has(&self, digest: &Digest) -> Result<bool, StoreError> {
        match self.store.head(&digest.key()).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(StoreError::blobs("look for a file")(error)),
        }
    }

    /// Reads a whole file into memory.
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

    /// The local path of a file.
    pub fn local(&self, digest: &Digest) -> PathBuf {
        self.root.join(&digest.0[..2]).join(&digest.0)
    }
}
