//! Requests that begin, list and finish submissions.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse as _, Response};
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use serde::{Deserialize, Serialize};
use time::format_description::well_known::Rfc3339;

use super::answer::{Problem, account_of, json_of};
use crate::store::{Account, BeginOutcome, Digest, Draft, FileRow};
use crate::submission::{BAG, FileSpec, JOURNAL, Limits, MAX_NAME, id_of, is_file_name};
use crate::{Badge, Claims, Division, Entry, Manifest, Service, Stage, SubmissionId};

/// Maximum size of the body of a request that begins a submission, bytes: about 250 for each file.
const MAX_BODY: usize = 8 << 20;
const BODY_TIME: Duration = Duration::from_secs(30);

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SubmissionRequest {
    manifest: Manifest,
    files: Vec<FileRequest>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileRequest {
    name: String,
    bytes: u64,
    sha256: String,
}

#[derive(Debug, Serialize)]
struct EntryJson {
    id: String,
    manifest: Manifest,
    account: String,
    state: Stage,
    reason: String,
    badge: Badge,
    claims: Claims,
    /// Only where it is ranked.
    division: Option<Division>,
    /// Subtasks in which it is ranked.
    ranked_tasks: Vec<String>,
    /// Why it is not ranked among all twelve; empty if it is.
    not_ranked: String,
    received: String,
    episodes_verified: u64,
    episodes_to_verify: u64,
    /// Only for the submitter, and only until the submission is received.
    #[serde(skip_serializing_if = "Option::is_none")]
    files: Option<Vec<FileJson>>,
}

#[derive(Debug, Serialize)]
struct FileJson {
    place: i64,
    name: String,
    bytes: i64,
    sha256: String,
    received: u64,
    stored: bool,
}

#[derive(Debug, Serialize)]
struct AccountJson {
    account: String,
    submissions_a_day: i64,
    max_bytes: i64,
    max_files: usize,
    max_file_bytes: u64,
    max_submission_bytes: u64,
    submissions: Vec<EntryJson>,
}

impl From<Entry> for EntryJson {
    fn from(entry: Entry) -> Self {
        Self {
            id: entry.id.to_string(),
            manifest: entry.manifest,
            account: entry.account,
            state: entry.state,
            reason: entry.reason,
            badge: entry.badge,
            claims: entry.claims,
            division: entry.division,
            ranked_tasks: entry.tasks,
            not_ranked: entry.obstacle,
            received: entry.received.format(&Rfc3339).unwrap_or_default(),
            episodes_verified: entry.progress.0,
            episodes_to_verify: entry.progress.1,
            files: None,
        }
    }
}

/// `GET /api/v1/account`: the account of a token, its limits and all its submissions.
pub(super) async fn account(State(service): State<Arc<Service>>, headers: HeaderMap) -> Result<Response, Problem> {
    let account = account_of(&service, &headers).await?;
    let submissions = service.store.every(Some(&account.name)).await?.into_iter().map(EntryJson::from).collect();
    let Limits { files, file_bytes, bytes } = service.options.limits;
    json_of(&AccountJson {
        account: account.name,
        submissions_a_day: account.submissions_a_day,
        max_bytes: account.max_bytes,
        max_files: files,
        max_file_bytes: file_bytes,
        max_submission_bytes: bytes,
        submissions,
    })
}

/// `GET /api/v1/submissions`: all submissions that are graded or verified, oldest first.
pub(super) async fn list(State(service): State<Arc<Service>>) -> Result<Response, Problem> {
    let entries: Vec<EntryJson> = service.store.entries().await?.into_iter().map(EntryJson::from).collect();
    json_of(&serde_json::json!({ "submissions": entries }))
}

/// `POST /api/v1/submissions`: announces the files. Sending the same again returns the same submission.
pub(super) async fn begin(
    State(service): State<Arc<Service>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let account = account_of(&service, &headers).await?;
    let request = read(body).await?;
    let (manifest, files) = check(request, &service.options.limits)?;
    let id = id_of(&account.name, &manifest, &files);
    let draft = Draft { id, manifest, files };
    let too_many = |message: String| Problem::new(StatusCode::TOO_MANY_REQUESTS, "limit", message);
    let status = match service.store.begin(&account, &draft).await? {
        BeginOutcome::New => StatusCode::CREATED,
        BeginOutcome::Known => StatusCode::OK,
        BeginOutcome::TooManyToday(most) => {
            return Err(too_many(format!("the account may begin only {most} submissions within 24 hours; wait")));
        }
        BeginOutcome::TooManyOpen(most) => {
            return Err(too_many(format!(
                "{most} submissions of the account still wait for files; finish one of them"
            )));
        }
        BeginOutcome::TooManyBytes(most) => {
            return Err(too_many(format!(
                "all submissions of the account together may have {most} bytes; ask the administrator for more"
            )));
        }
    };
    if status == StatusCode::CREATED {
        tracing::info!(submission = %id, account = account.name, files = draft.files.len(), "begun");
    }
    Ok((status, own(&service, id).await?).into_response())
}

/// `GET /api/v1/submissions/{id}`: open to everybody once it is graded; before that, and if it was refused, only to its account.
pub(super) async fn one(
    State(service): State<Arc<Service>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let missing = || Problem::missing("there is no such submission");
    let id: SubmissionId = id.parse().map_err(|_| missing())?;
    let entry = service.store.entry(id).await?.ok_or_else(missing)?;
    if matches!(entry.state, Stage::Graded | Stage::Verified) {
        return json_of(&EntryJson::from(entry));
    }
    let account = account_of(&service, &headers).await?;
    if entry.account != account.name {
        return Err(missing());
    }
    own(&service, id).await
}

/// `GET /api/v1/submissions/{id}/results`: `results.json` of a graded submission.
pub(super) async fn results(State(service): State<Arc<Service>>, Path(id): Path<String>) -> Result<Response, Problem> {
    let missing = || Problem::missing("there is no such submission, or it is not graded yet");
    let id: SubmissionId = id.parse().map_err(|_| missing())?;
    let entry = service.store.entry(id).await?.ok_or_else(missing)?;
    if !matches!(entry.state, Stage::Graded | Stage::Verified) {
        return Err(missing());
    }
    let results = service.store.results(id).await?.ok_or_else(missing)?;
    json_of(&*results)
}

/// `POST /api/v1/submissions/{id}/finish`: ends the upload. The answer 202 means that the submission is accepted.
pub(super) async fn finish(
    State(service): State<Arc<Service>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let account = account_of(&service, &headers).await?;
    let id = owned(&service, &id, &account).await?.id;
    let left = service.store.receive(id, &account.name).await?;
    if left > 0 {
        return Err(Problem::conflict("files", format!("{left} files are still missing; send them first")));
    }
    tracing::info!(submission = %id, account = account.name, "received");
    service.received.notify_one();
    if let Err(error) = service.store.forget_incoming(id).await {
        tracing::warn!(error = fiatlux_cli::in_full(&error), "cannot remove the empty folder of an upload");
    }
    Ok((StatusCode::ACCEPTED, own(&service, id).await?).into_response())
}

/// A submission, if it belongs to the account.
pub(super) async fn owned(service: &Service, id: &str, account: &Account) -> Result<Entry, Problem> {
    let missing = || Problem::missing("your account has no such submission");
    let id: SubmissionId = id.parse().map_err(|_| missing())?;
    service.store.entry(id).await?.filter(|entry| entry.account == account.name).ok_or_else(missing)
}

/// A submission as its submitter sees it.
async fn own(service: &Service, id: SubmissionId) -> Result<Response, Problem> {
    let entry = service.store.entry(id).await?.ok_or_else(|| Problem::missing("there is no such submission"))?;
    let mut shown = EntryJson::from(entry);
    if shown.state == Stage::Uploading {
        let folder = service.store.incoming(id);
        let files = service.store.files(id).await?;
        // One call to the file system for each file: too slow for a thread that serves other requests.
        let listed = tokio::task::spawn_blocking(move || {
            let length = |file: &FileRow| std::fs::metadata(folder.join(file.place.to_string())).map_or(0, |m| m.len());
            let shown = |file: FileRow| FileJson {
                received: if file.stored { file.bytes as u64 } else { length(&file) },
                place: file.place,
                name: file.name,
                bytes: file.bytes,
                sha256: file.sha256,
                stored: file.stored,
            };
            files.into_iter().map(shown).collect()
        });
        shown.files = Some(listed.await.map_err(|_| Problem::busy("the files cannot be listed; try again"))?);
    }
    json_of(&shown)
}

async fn read(body: Body) -> Result<SubmissionRequest, Problem> {
    let collected = tokio::time::timeout(BODY_TIME, Limited::new(body, MAX_BODY).collect()).await;
    let bytes = match collected {
        Err(_) => return Err(Problem::slow(format!("the body did not arrive within {} s", BODY_TIME.as_secs()))),
        Ok(Err(error)) if error.is::<LengthLimitError>() => {
            return Err(Problem::too_large(format!("the list of files may have at most {MAX_BODY} bytes")));
        }
        Ok(Err(_)) => return Err(Problem::request("the body was cut off")),
        Ok(Ok(collected)) => collected.to_bytes(),
    };
    serde_json::from_slice(&bytes).map_err(|error| {
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "json", format!("the body cannot be read as JSON: {error}"))
    })
}

/// Checks an announced submission; returns its files sorted by name.
fn check(request: SubmissionRequest, limits: &Limits) -> Result<(Manifest, Vec<FileSpec>), Problem> {
    let wrong = |code, message: String| Problem::new(StatusCode::UNPROCESSABLE_ENTITY, code, message);
    request.manifest.check().map_err(|error| wrong("manifest", error.to_string()))?;
    if request.files.is_empty() || !request.files.iter().any(|file| file.name.ends_with(BAG)) {
        return Err(wrong("files", format!("files: there is no bag; name some that end in {BAG}")));
    }
    if request.files.len() > limits.files {
        return Err(Problem::too_large(format!(
            "files: {} of them; at most {} are allowed",
            request.files.len(),
            limits.files
        )));
    }
    let mut names = BTreeSet::new();
    let mut total: u64 = 0;
    let mut files = Vec::with_capacity(request.files.len());
    for (place, FileRequest { name, bytes, sha256 }) in request.files.into_iter().enumerate() {
        if !is_file_name(&name) {
            return Err(wrong(
                "files",
                format!(
                    "files[{place}].name: use only letters, digits, -, _ and ., {MAX_NAME} at most, and end it in {BAG} or \
                     {JOURNAL}"
                ),
            ));
        }
        if bytes == 0 || bytes > limits.file_bytes {
            let most = limits.file_bytes;
            return Err(Problem::too_large(format!(
                "files[{place}].bytes: {name} has {bytes}; 1 to {most} are allowed"
            )));
        }
        total = total.saturating_add(bytes);
        let Some(sha256) = Digest::parse(&sha256) else {
            let message = format!("files[{place}].sha256: write 64 hexadecimal digits in lower case");
            return Err(wrong("files", message));
        };
        if !names.insert(name.clone()) {
            return Err(wrong("files", format!("files[{place}].name: {name} is listed twice")));
        }
        files.push(FileSpec { name, bytes, sha256 });
    }
    if total > limits.bytes {
        return Err(Problem::too_large(format!("files: {total} bytes together; at most {} are allowed", limits.bytes)));
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok((request.manifest, files))
}
