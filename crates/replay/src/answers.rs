//! Answers to the requests of a browser.

use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use fiatlux_cli::in_full;
use tokio::fs::File;

use crate::Packed;
use crate::cache::PackedReplay;
use crate::page::Page;
use crate::served::ServedBags;
use crate::site::{download, for_ever, guarded, host_of, is_own, page_part};

const HTML: &str = "text/html; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";
const BYTES: &str = "application/octet-stream";

pub(crate) fn router(served: Arc<ServedBags>) -> Router {
    Router::new()
        .route("/", get(home))
        .route("/episodes.json", get(episodes))
        .route("/episode/{index}", get(episode))
        .route("/episode/{index}/document.json", get(document))
        .route("/episode/{index}/meshes.bin", get(meshes))
        .route("/episode/{index}/track.bin", get(track))
        .route("/episode/{index}/joints.bin", get(joints))
        .route("/episode/{index}/pictures.bin", get(pictures))
        .route("/episode/{index}/bag", get(bag))
        .route("/shapes/{digest}", get(shapes))
        .route("/page/{file}", get(page_file))
        .fallback(|| async { problem(StatusCode::NOT_FOUND, "nothing is at this address; start at /") })
        .layer(from_fn(guard))
        .with_state(served)
}

/// Lets only requests to this machine pass, and adds the headers of every answer.
async fn guard(request: Request, next: Next) -> Response {
    let mut answer = if is_own(host_of(request.headers()), &[]) {
        next.run(request).await
    } else {
        problem(StatusCode::MISDIRECTED_REQUEST, "this server answers only to addresses of this machine and localhost")
    };
    answer.headers_mut().entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    guarded(answer)
}

async fn home(State(served): State<Arc<ServedBags>>) -> Response {
    if served.bags.count() == 1 { Redirect::temporary("/episode/0").into_response() } else { page(&served.list) }
}

async fn episodes(State(served): State<Arc<ServedBags>>) -> Response {
    let listed = tokio::task::spawn_blocking(move || serde_json::to_vec(&served.bags.list())).await;
    match listed {
        Ok(Ok(json)) => content(JSON, json),
        _ => problem(StatusCode::INTERNAL_SERVER_ERROR, "the bags cannot be listed"),
    }
}

async fn episode(State(served): State<Arc<ServedBags>>, Path(index): Path<String>) -> Response {
    match index_of(&index).and_then(|index| served.bags.file(index)) {
        Some(_) => page(&served.replay),
        None => no_episode(&served),
    }
}

async fn document(state: State<Arc<ServedBags>>, asked: HeaderMap, index: Path<String>) -> Response {
    part(state, asked, index, JSON, |shown| shown.document).await
}

async fn meshes(state: State<Arc<ServedBags>>, asked: HeaderMap, index: Path<String>) -> Response {
    part(state, asked, index, BYTES, |shown| shown.meshes).await
}

async fn track(state: State<Arc<ServedBags>>, asked: HeaderMap, index: Path<String>) -> Response {
    part(state, asked, index, BYTES, |shown| shown.track).await
}

async fn shapes(State(served): State<Arc<ServedBags>>, asked: HeaderMap, Path(digest): Path<String>) -> Response {
    match served.replays.block(&digest) {
        Some(block) => for_ever(block.answer(&asked, BYTES)),
        None => problem(StatusCode::NOT_FOUND, "no replay with these shapes was opened recently"),
    }
}

async fn joints(state: State<Arc<ServedBags>>, asked: HeaderMap, index: Path<String>) -> Response {
    part(state, asked, index, BYTES, |shown| shown.joints).await
}

async fn pictures(state: State<Arc<ServedBags>>, asked: HeaderMap, index: Path<String>) -> Response {
    part(state, asked, index, BYTES, |shown| shown.pictures).await
}

async fn part(
    State(served): State<Arc<ServedBags>>,
    asked: HeaderMap,
    Path(index): Path<String>,
    kind: &'static str,
    part: fn(PackedReplay) -> Packed,
) -> Response {
    let Some(index) = index_of(&index) else { return no_episode(&served) };
    let reader = Arc::clone(&served);
    match tokio::task::spawn_blocking(move || reader.show(index)).await {
        Ok(Some(Ok(shown))) => part(shown).answer(&asked, kind),
        Ok(Some(Err(error))) => problem(StatusCode::UNPROCESSABLE_ENTITY, &in_full(&error)),
        Ok(None) => no_episode(&served),
        Err(_) => problem(StatusCode::INTERNAL_SERVER_ERROR, "the bag cannot be read"),
    }
}

async fn bag(
    State(served): State<Arc<ServedBags>>,
    method: Method,
    asked: HeaderMap,
    Path(index): Path<String>,
) -> Response {
    let Some(path) = index_of(&index).and_then(|index| served.bags.file(index)) else { return no_episode(&served) };
    let answer = async {
        let file = File::open(path).await?;
        let metadata = file.metadata().await?;
        // A bag may still be growing.
        let modified = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        let tag = format!("{:x}-{:x}", modified.as_nanos(), metadata.len());
        download(file, &tag, BYTES, &method, &asked).await
    };
    let Ok(mut answer) = answer.await else {
        return problem(StatusCode::NOT_FOUND, "the bag can no longer be read");
    };
    let name = format!("attachment; filename=\"{}\"", plain_name(path));
    if let Ok(name) = HeaderValue::from_str(&name) {
        answer.headers_mut().insert(header::CONTENT_DISPOSITION, name);
    }
    answer
}

async fn page_file(Path(file): Path<String>) -> Response {
    match page_part(&file) {
        Some((kind, text)) => content(kind, text),
        None => problem(StatusCode::NOT_FOUND, "the page has no such file"),
    }
}

fn index_of(text: &str) -> Option<usize> {
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { text.parse().ok() } else { None }
}

fn no_episode(served: &ServedBags) -> Response {
    let last = served.bags.count() - 1;
    problem(StatusCode::NOT_FOUND, &format!("there is no such episode; they are numbered from 0 to {last}"))
}

fn page(page: &Page) -> Response {
    let mut answer = content(HTML, page.html.clone());
    if let Ok(policy) = HeaderValue::from_str(&page.policy) {
        answer.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    answer
}

fn content(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], body.into()).into_response()
}

fn problem(status: StatusCode, what: &str) -> Response {
    (status, content(TEXT, what.to_owned())).into_response()
}

/// A file's name, reduced to characters that are safe in a header.
fn plain_name(path: &FilePath) -> String {
    let name = path.file_name().map_or_else(Default::default, |name| name.to_string_lossy());
    name.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}
