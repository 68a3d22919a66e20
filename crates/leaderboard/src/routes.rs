//! All routes of the service.

use std::sync::Arc;

use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};

use crate::{Service, api, metrics, pages, visitors};

/// Routes of the whole service: `/api/...`, `/health`, `/ready` and the pages.
pub fn router(service: Arc<Service>) -> Router {
    let measured = from_fn_with_state(Arc::clone(&service), metrics::measure);
    api::router(Arc::clone(&service)).merge(pages::router(service)).layer(from_fn(visitors::admit)).layer(measured)
}
