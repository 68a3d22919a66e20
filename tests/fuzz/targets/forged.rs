//! A submission of a forger: a bag in parts, whose digests are made anew, sent to a leaderboard and graded. Nothing stops the
//! service, and nothing gets a rank: no server simulates it again.
#![no_main]

use std::path::PathBuf;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use fiatlux_bag::Bag;
use fiatlux_fuzz::{folder, put_together, seeds_wanted, take_apart, write_seeds};
use fiatlux_leaderboard::{Jobs, Quota, Service, ServiceOptions, Store, router};
use http_body_util::BodyExt as _;
use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tokio::runtime::Runtime;
use tower::ServiceExt as _;

static PATH: LazyLock<PathBuf> = LazyLock::new(|| folder("forged").join("a.mcap"));

struct Board {
    runtime: Runtime,
    store: Store,
    router: Router,
    token: String,
    // It grades until it is dropped.
    _jobs: Jobs,
}

static BOARD: LazyLock<Board> = LazyLock::new(|| {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    let runtime = builder.worker_threads(1).enable_all().build().expect("a runtime");
    let (store, router, token, jobs) = runtime.block_on(async {
        let store = Store::open(&folder("forged-board")).await.expect("a store");
        let quota = Quota { submissions_a_day: u32::MAX, max_bytes: u64::MAX };
        store.make_account("lab", quota).await.expect("an account");
        let token = store.make_token("lab", 1).await.expect("a token");
        let options = ServiceOptions { grade_workers: 1, ..ServiceOptions::default() };
        let service = Arc::new(Service::new(store.clone(), options));
        let jobs = Jobs::start(&service, Vec::new(), 1).expect("threads");
        (store, router(service), token, jobs)
    });
    Board { runtime, store, router, token, _jobs: jobs }
});

impl Board {
    async fn ask(&self, method: &str, address: &str, body: Vec<u8>) -> Value {
        let request =
            Request::builder().method(method).uri(address).header("Authorization", format!("Bearer {}", self.token));
        let answer = self.router.clone().oneshot(request.body(Body::from(body)).expect("a request")).await;
        let body = answer.expect("an answer").into_body().collect().await.expect("a body").to_bytes();
        serde_json::from_slice(&body).expect("JSON")
    }

    /// Sends a bag of this policy, and returns what became of it.
    async fn submit(&self, policy: &str, bag: Vec<u8>) -> Option<Value> {
        let sha256: String = Sha256::digest(&bag).iter().map(|byte| format!("{byte:02x}")).collect();
        let files = [json!({ "name": "a.mcap", "bytes": bag.len(), "sha256": sha256 })];
        let wish = json!({ "manifest": { "policy": policy }, "files": files });
        let begun = self.ask("POST", "/api/v1/submissions", wish.to_string().into_bytes()).await;
        // A name that no manifest takes.
        let address = format!("/api/v1/submissions/{}", begun["id"].as_str()?);
        self.ask("PUT", &format!("{address}/files/0?offset=0"), bag).await;
        self.ask("POST", &format!("{address}/finish"), Vec::new()).await;
        loop {
            let entry = self.ask("GET", &address, Vec::new()).await;
            if ["graded", "refused"].contains(&entry["state"].as_str().expect("a state")) {
                let id = entry["id"].as_str().expect("an id").parse().expect("an id");
                self.store.remove_submission(id).await.expect("it is there");
                return Some(entry);
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
}

fuzz_target!(init: if let Some((folder, bag)) = seeds_wanted() {
    write_seeds(&folder, [("parts".to_owned(), take_apart(&bag))]);
}, |data: &[u8]| {
    let _ = std::fs::remove_file(&*PATH);
    if put_together(data, &PATH).is_none() {
        return;
    }
    let policy = Bag::open(&*PATH).map_or_else(|_| "zero".to_owned(), |bag| bag.header().policy.clone());
    let bag = std::fs::read(&*PATH).expect("a file");
    let board = &*BOARD;
    let Some(entry) = board.runtime.block_on(board.submit(&policy, bag)) else { return };
    assert!(!entry["reason"].as_str().expect("a reason").contains("the grader failed"), "{entry}");
    assert!(entry["division"].is_null() && entry["badge"] == "self_reported", "{entry}");
    assert!(entry["claims"]["rows"]["proof"] != "proven" && !entry["not_ranked"].as_str().expect("why").is_empty(), "{entry}");
});
