//! Counters of the service, in the text format of Prometheus.

use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Instant;

use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use fiatlux_cli::{PROMETHEUS_TEXT, metric_head};

use crate::api::Problem;
use crate::counts::BUCKETS_MS;
use crate::{Service, StoreError};

/// Counts down when dropped, even if the request is cancelled halfway.
struct OpenCount<'a>(&'a AtomicI64);

impl<'a> OpenCount<'a> {
    fn new(count: &'a AtomicI64) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for OpenCount<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

pub(crate) async fn measure(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    let metrics = &service.metrics;
    let counted = OpenCount::new(&metrics.open);
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().map_or_else(String::new, |path| path.as_str().to_owned());
    let start = Instant::now();
    let answer = next.run(request).await;
    drop(counted);
    let taken = start.elapsed();
    let status = answer.status().as_u16();
    if let Some(count) = usize::from(status / 100).checked_sub(1).and_then(|class| metrics.answers.get(class)) {
        count.fetch_add(1, Ordering::Relaxed);
    }
    // The time of an upload only measures its sender's connection.
    if method != axum::http::Method::PUT {
        let ms = taken.as_millis() as u64;
        let at = BUCKETS_MS.iter().position(|end| ms < *end).unwrap_or(BUCKETS_MS.len());
        metrics.buckets[at].fetch_add(1, Ordering::Relaxed);
        metrics.total_us.fetch_add(taken.as_micros() as u64, Ordering::Relaxed);
    }
    tracing::debug!(%method, route, status, ms = taken.as_millis() as u64, "request");
    answer
}

/// The only page of the address for metrics.
pub(crate) fn router(service: Arc<Service>) -> Router {
    Router::new().route("/metrics", get(page)).with_state(service)
}

async fn page(State(service): State<Arc<Service>>) -> Result<Response, Problem> {
    let text = text(&service).await?;
    Ok(([(header::CONTENT_TYPE, PROMETHEUS_TEXT)], text).into_response())
}

async fn text(service: &Service) -> Result<String, StoreError> {
    let metrics = &service.metrics;
    let mut out = String::new();
    metric_head(&mut out, "requests_total", "counter", "Responses by class of status.");
    for (class, count) in (1..).zip(&metrics.answers) {
        let count = count.load(Ordering::Relaxed);
        let _ = writeln!(out, "fiatlux_requests_total{{status=\"{class}xx\"}} {count}");
    }
    metric_head(&mut out, "request_seconds", "histogram", "Time to a response, without uploads.");
    let mut below = 0;
    for (end, count) in BUCKETS_MS.iter().zip(&metrics.buckets) {
        below += count.load(Ordering::Relaxed);
        let _ = writeln!(out, "fiatlux_request_seconds_bucket{{le=\"{}\"}} {below}", *end as f64 / 1000.0);
    }
    let total = metrics.total_us.load(Ordering::Relaxed) as f64 / 1e6;
    let all = below + metrics.buckets[BUCKETS_MS.len()].load(Ordering::Relaxed);
    let _ = writeln!(out, "fiatlux_request_seconds_bucket{{le=\"+Inf\"}} {all}");
    let _ = writeln!(out, "fiatlux_request_seconds_sum {total}\nfiatlux_request_seconds_count {all}");
    for (name, help, count) in [
        ("requests_open", "Requests that are being answered now.", &metrics.open),
        ("connections_open", "Connections that are open now.", &metrics.connections),
    ] {
        metric_head(&mut out, name, "gauge", help);
        let _ = writeln!(out, "fiatlux_{name} {}", count.load(Ordering::Relaxed));
    }
    for (name, help, count) in [
        ("refused_total", "Connections and requests refused because their address has too many.", &metrics.refused),
        ("uploaded_bytes_total", "Bytes of files received.", &metrics.uploaded_bytes),
        ("graded_total", "Submissions that were graded or refused.", &metrics.graded),
        ("verified_total", "Episodes whose verification has a verdict.", &metrics.verified),
        ("verified_steps_total", "Control steps simulated to verify episodes.", &metrics.verified_steps),
        ("verify_retries_total", "Verifications that failed without a verdict and are tried again.", &metrics.retries),
    ] {
        metric_head(&mut out, name, "counter", help);
        let _ = writeln!(out, "fiatlux_{name} {}", count.load(Ordering::Relaxed));
    }
    metric_head(&mut out, "verifying_seconds_total", "counter", "Time spent verifying, summed over parallel workers.");
    let verifying = metrics.verifying_ms.load(Ordering::Relaxed) as f64 / 1000.0;
    let _ = writeln!(out, "fiatlux_verifying_seconds_total {verifying}");
    metric_head(&mut out, "submissions", "gauge", "Submissions by state.");
    for count in service.store.states().await? {
        let _ = writeln!(out, "fiatlux_submissions{{state=\"{}\"}} {}", count.kind, count.count);
    }
    metric_head(&mut out, "episodes", "gauge", "Episodes by the verdict of their verification.");
    for count in service.store.verdicts().await? {
        let _ = writeln!(out, "fiatlux_episodes{{verdict=\"{}\"}} {}", count.kind, count.count);
    }
    Ok(out)
}
