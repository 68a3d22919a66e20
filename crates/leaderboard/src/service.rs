//! The running service: its store, and the router over it.

use std::sync::Arc;

use axum::Router;

use crate::Store;

/// What handlers share.
#[derive(Debug)]
pub struct Service {
    /// Submissions, results and bags.
    pub store: Store,
}

/// All that is answered: `/api/...`, `/health`, `/metrics` and the pages.
pub fn router(_service: Arc<Service>) -> Router {
    Router::new()
}
