//! Uploads: each resumes where the last connection stopped, and a file is kept only if it has the announced digest.

use std::fs::TryLockError;
use std::path::Path as FilePath;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::Response;
use http_body_util::BodyExt as _;
use serde_json::json;
use tokio::fs::File;
use tokio::io::AsyncWriteExt as _;

use super::answer::{Problem, account_of, json_of};
use super::submissions::owned;
use crate::store::StoredFile;
use crate::{Pace, Service, Stage, StoreError, SubmissionId};

/// Bytes that are collected before they are written. A frame of a body has 32 kB at most.
const PART: usize = 256 << 10;

/// `PUT /api/v1/submissions/{id}/files/{place}?offset=N`: bytes of a file from `N` on, the number
/// that has arrived.
pub(super) async fn upload(
    State(service): State<Arc<Service>>,
    Path((id, place)): Path<(String, String)>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let account = account_of(&service, &headers).await?;
    let entry = owned(&service, &id, &account).await?;
    let no_file = || Problem::missing("the submission has no such file; places are those of its list of files");
    let place: u32 = number(&place).and_then(|place| place.try_into().ok()).ok_or_else(no_file)?;
    let file = service.store.file(entry.id, place).await?.ok_or_else(no_file)?;
    if file.stored {
        return json_of(&json!({ "received": file.bytes, "stored": true }));
    }
    if entry.state != Stage::Uploading {
        return Err(Problem::conflict("state", "the submission is complete and takes no more files"));
    }
    let offset = offset_in(uri.query()).ok_or_else(|| Problem::request("write ?offset=N, with N in bytes"))?;
    let folder = service.store.incoming(entry.id);
    tokio::fs::create_dir_all(&folder).await.map_err(StoreError::io("make", &folder))?;
    let path = folder.join(place.to_string());
    let io = |action| StoreError::io(action, &path);
    let part = std::fs::File::options().create(true).append(true).open(&path).map_err(io("open"))?;
    // The other request may be another service's on this store.
    match part.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            return Err(Problem::conflict("busy", "another request is sending this file; try again when it has ended"));
        }
        Err(TryLockError::Error(error)) => return Err(io("lock")(error).into()),
    }
    let out = File::from_std(part.try_clone().map_err(io("open"))?);
    let received = append(&service, &path, out, &file, offset, body).await?;
    if received < file.bytes {
        return json_of(&json!({ "received": received, "stored": false }));
    }
    // A client that has sent everything may disconnect now: the rest is still done.
    let sealing = tokio::spawn(async move {
        let sealed = seal(&service, &path, &file, entry.id, place).await;
        drop(part);
        sealed
    });
    let is_it = sealing.await.map_err(|_| Problem::busy("the file could not be stored; send it again"))??;
    if !is_it {
        let message = "the file does not have the announced SHA-256 and was deleted: send it again from offset 0, or \
                       announce the changed file as a new submission";
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "digest", message).with_received(0));
    }
    json_of(&json!({ "received": received, "stored": true }))
}

/// Appends the body to the bytes that have arrived; returns their new number.
async fn append(
    service: &Service,
    path: &FilePath,
    mut out: File,
    file: &StoredFile,
    offset: u64,
    body: Body,
) -> Result<u64, Problem> {
    let io = |action| StoreError::io(action, path);
    let length = out.metadata().await.map_err(io("read"))?.len();
    if offset != length {
        let message = format!("{length} bytes of the file have arrived; resume at that offset");
        return Err(Problem::conflict("offset", message).with_received(length));
    }
    let mut part = Vec::new();
    let taken = take(service, &mut out, &mut part, file.bytes, length, body).await;
    // Bytes that came before the interruption are kept.
    write(service, &mut out, &mut part).await.map_err(io("write"))?;
    taken.map_err(|failed| match failed {
        UploadError::Write(source) => io("write")(source).into(),
        UploadError::Refused(problem) => problem,
    })
}

enum UploadError {
    Write(std::io::Error),
    Refused(Problem),
}

/// Receives a body; returns the length of the file once `part` is written, too.
async fn take(
    service: &Service,
    out: &mut File,
    part: &mut Vec<u8>,
    whole: u64,
    mut length: u64,
    mut body: Body,
) -> Result<u64, UploadError> {
    let Pace { silence, start: free, min_rate } = service.options.pace;
    let (start, first) = (Instant::now(), length);
    loop {
        let frame = match tokio::time::timeout(silence, body.frame()).await {
            Ok(Some(Ok(frame))) => frame,
            Ok(None) => return Ok(length),
            Ok(Some(Err(_))) => {
                return Err(UploadError::Refused(
                    Problem::request("the upload was interrupted; resume at `received`").with_received(length),
                ));
            }
            Err(_) => {
                let message = format!("nothing arrived for {} s; resume at `received`", silence.as_secs());
                return Err(UploadError::Refused(Problem::slow(message).with_received(length)));
            }
        };
        let Ok(data) = frame.into_data() else { continue };
        let room = whole - length;
        if data.len() as u64 > room {
            let message = format!("the file was announced with {whole} bytes, but more arrived");
            return Err(UploadError::Refused(Problem::too_large(message).with_received(length)));
        }
        part.extend_from_slice(&data);
        if part.len() >= PART {
            write(service, out, part).await.map_err(UploadError::Write)?;
        }
        length += data.len() as u64;
        service.metrics.uploaded_bytes.fetch_add(data.len() as u64, Ordering::Relaxed);
        let taken = start.elapsed();
        if taken > free && (length - first) / taken.as_secs().max(1) < min_rate && length < whole {
            let message =
                format!("less than {min_rate} bytes/s arrived; resume at `received` over a better connection");
            return Err(UploadError::Refused(Problem::slow(message).with_received(length)));
        }
    }
}

/// Writes bytes of a body. Few uploads do so at once: each write takes a thread, and dozens of them would delay pages.
async fn write(service: &Service, out: &mut File, part: &mut Vec<u8>) -> std::io::Result<()> {
    // It is never closed.
    let _permit = service.writers.acquire().await.map_err(std::io::Error::other)?;
    out.write_all(part).await?;
    part.clear();
    out.flush().await
}

/// Keeps a complete file if it has the announced digest; else removes it.
async fn seal(
    service: &Service,
    path: &FilePath,
    file: &StoredFile,
    id: SubmissionId,
    place: u32,
) -> Result<bool, Problem> {
    let busy = |_| Problem::busy("the service is stopping; send the rest again later");
    let _permit = service.sealers.acquire().await.map_err(busy)?;
    let is_it = service.store.blobs.put_checked(&file.digest, path).await?;
    if is_it {
        service.store.set_stored(id, place).await?;
    }
    tokio::fs::remove_file(path).await.map_err(StoreError::io("remove", path))?;
    Ok(is_it)
}

fn offset_in(query: Option<&str>) -> Option<u64> {
    query.and_then(|query| query.strip_prefix("offset=")).and_then(number)
}

/// A number of digits only: no sign, no space.
fn number(text: &str) -> Option<u64> {
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { text.parse().ok() } else { None }
}
