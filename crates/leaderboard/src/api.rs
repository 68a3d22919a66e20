//! The JSON API for programs. `api/openapi.json` describes it, and a test compares the two.

mod answer;
mod submissions;
mod upload;

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{Method, StatusCode};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, post, put};

use crate::Service;
pub(crate) use answer::Problem;
use answer::json_text;

/// Time limit of every request except uploads.
const PATIENCE: Duration = Duration::from_secs(60);

const OPENAPI: &str = include_str!("api/openapi.json");

/// Every address of the API with its methods, as in `openapi.json`.
pub(crate) fn router(service: Arc<Service>) -> Router {
    Router::new()
        .route("/api/openapi.json", get(openapi))
        .route("/api/v1/account", get(submissions::account))
        .route("/api/v1/submissions", get(submissions::list).post(submissions::begin))
        .route("/api/v1/submissions/{id}", get(submissions::one))
        .route("/api/v1/submissions/{id}/files/{place}", put(upload::upload))
        .route("/api/v1/submissions/{id}/finish", post(submissions::finish))
        .route("/api/v1/submissions/{id}/results", get(submissions::results))
        .route("/api/{*other}", axum::routing::any(nothing))
        .route("/health", get(health))
        .route("/ready", get(ready))
        .method_not_allowed_fallback(not_so)
        .layer(from_fn(bounded))
        .with_state(service)
}

/// Ends requests that take too long. An upload has limits of its own.
async fn bounded(request: Request, next: Next) -> Response {
    if request.method() == Method::PUT {
        return next.run(request).await;
    }
    match tokio::time::timeout(PATIENCE, next.run(request)).await {
        Ok(answer) => answer,
        Err(_) => Problem::busy("the request took too long; try again later").into_response(),
    }
}

async fn openapi() -> Response {
    json_text(OPENAPI.to_owned())
}

async fn nothing() -> Problem {
    Problem::missing("nothing is at this address; /api/openapi.json lists all addresses")
}

async fn not_so() -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "method",
        "this address does not take this method; /api/openapi.json lists those it takes",
    )
}

/// Answers as long as the process lives, in any state of the store.
async fn health() -> &'static str {
    "ok\n"
}

/// Answers 200 only if the database answers as well.
async fn ready(State(service): State<Arc<Service>>) -> Result<&'static str, Problem> {
    match service.store.ping().await {
        Ok(()) => Ok("ok\n"),
        Err(error) => {
            tracing::error!(error = fiatlux_cli::in_full(&error), "the service is not ready");
            Err(Problem::busy("the database does not answer"))
        }
    }
}
