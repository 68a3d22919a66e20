//! The pages, rendered on the server: leaderboard, runs, episodes with their replays, comparisons.
//!
//! Everything but the replay works without JavaScript. No address becomes the path of a file, and text from a
//! submission is escaped by the templates. The Content-Security-Policy of each page forbids loading from other hosts.

mod answer;
mod board;
mod compare;
mod episode;
mod heavy;
mod key;
mod partial;
mod run;
mod show;
mod state;
mod tasks;

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::middleware::map_response;
use axum::response::Response;
use axum::routing::get;
use fiatlux_grading::report;
use fiatlux_replay::site::{guarded, page_part};

use self::answer::{Problem, unchanging};
use self::state::Pages;
use crate::Service;

const CSS: &str = "text/css; charset=utf-8";
const BOARD_STYLE: &str = include_str!("../style/board.css");
const ICON: &str = include_str!("../style/icon.svg");

pub(crate) fn router(service: Arc<Service>) -> Router {
    Router::new()
        .route("/", get(board::board))
        .route("/about", get(board::about))
        .route("/tasks/{task}", get(tasks::task))
        .route("/runs/{id}", get(run::run))
        .route("/runs/{id}/tasks/{task}", get(run::task))
        .route("/runs/{id}/tasks/{task}/still.png", get(tasks::still))
        .route("/runs/{id}/tasks/{task}/clip.png", get(tasks::clip))
        .route("/runs/{id}/episodes/{key}", get(episode::episode))
        .route("/runs/{id}/episodes/{key}/document.json", get(episode::document))
        .route("/runs/{id}/episodes/{key}/meshes.bin", get(episode::meshes))
        .route("/runs/{id}/episodes/{key}/track.bin", get(episode::track))
        .route("/runs/{id}/episodes/{key}/joints.bin", get(episode::joints))
        .route("/runs/{id}/episodes/{key}/pictures.bin", get(episode::pictures))
        .route("/runs/{id}/episodes/{key}/bag", get(episode::bag))
        .route("/runs/{id}/episodes/{key}/figure.svg", get(episode::figure))
        .route("/shapes/{digest}", get(episode::shapes))
        .route("/compare", get(compare::choose))
        .route("/compare/{a}/{b}", get(compare::runs))
        .route("/compare/{a}/{b}/episodes/{key}", get(compare::episodes))
        .route("/page/{file}", get(page_file))
        .route("/style/{file}", get(style))
        .fallback(nothing)
        .layer(map_response(|answer: Response| async { guarded(answer) }))
        .with_state(Arc::new(Pages::new(service)))
}

/// A module or the style of replays.
async fn page_file(asked: HeaderMap, Path(file): Path<String>) -> Result<Response, Problem> {
    let (kind, text) = page_part(&file).ok_or(Problem::Nothing)?;
    Ok(unchanging(&asked, kind, text))
}

async fn style(asked: HeaderMap, Path(file): Path<String>) -> Result<Response, Problem> {
    let (kind, text) = match file.as_str() {
        "report.css" => (CSS, report::STYLE),
        "board.css" => (CSS, BOARD_STYLE),
        "icon.svg" => ("image/svg+xml", ICON),
        _ => return Err(Problem::Nothing),
    };
    Ok(unchanging(&asked, kind, text))
}

async fn nothing() -> Problem {
    Problem::Nothing
}
