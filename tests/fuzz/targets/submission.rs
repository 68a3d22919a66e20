//! A request to the leaderboard with a good token: `METHOD ADDRESS` in the first line, where `@` stands for a submission of one
//! file, and the body below it.
#![no_main]

use std::sync::{Arc, LazyLock};

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode};
use fiatlux_fuzz::{folder, seeds_wanted, write_seeds};
use fiatlux_leaderboard::{Quota, Service, ServiceOptions, Store, router};
use http_body_util::BodyExt as _;
use libfuzzer_sys::fuzz_target;
use tokio::runtime::Runtime;
use tower::ServiceExt as _;

/// The submission that is always there: one file of three bytes, "abc".
const WISH: &str = r#"{"manifest":{"policy":"zero"},"files":[{"name":"a.mcap","bytes":3,
"sha256":"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}]}"#;

/// Requests to begin with.
const SEEDS: [&str; 12] = [
    "PUT /api/v1/submissions/@/files/0?offset=0\nab",
    "PUT /api/v1/submissions/@/files/0?offset=2\nc",
    "POST /api/v1/submissions/@/finish\n",
    "GET /api/v1/submissions/@\n",
    "GET /api/v1/submissions/@/results\n",
    "GET /api/v1/account\n",
    "GET /?division=4-lockstep-standard-inspire&cells=clean&page=2\n",
    "GET /runs/@/tasks/S05?page=2\n",
    "GET /runs/@/episodes/S05-s64-e0/track.bin\n",
    "GET /compare/@/@?only=different&page=1\n",
    "GET /compare?run=@&run=@\n",
    "GET /page/main.js\n",
];

struct Board {
    runtime: Runtime,
    store: Store,
    router: Router,
    token: String,
    id: String,
}

static BOARD: LazyLock<Board> = LazyLock::new(|| {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let (store, router, token) = runtime.block_on(async {
        let store = Store::open(&folder("submission")).await.expect("a store");
        let quota = Quota { submissions_a_day: u32::MAX, ..Quota::default() };
        store.make_account("lab", quota).await.expect("an account");
        let token = store.make_token("lab", 1).await.expect("a token");
        let service = Arc::new(Service::new(store.clone(), ServiceOptions::default()));
        (store, router(service), token)
    });
    let mut board = Board { runtime, store, router, token, id: String::new() };
    board.id = board.begin();
    board
});

impl Board {
    fn ask(&self, method: &str, address: &str, body: &[u8]) -> Option<(StatusCode, String)> {
        let request =
            Request::builder().method(method).uri(address).header("Authorization", format!("Bearer {}", self.token));
        let request = request.body(Body::from(body.to_vec())).ok()?;
        let answer = self.runtime.block_on(async {
            let answer = self.router.clone().oneshot(request).await.expect("an answer");
            let status = answer.status();
            (status, answer.into_body().collect().await.expect("a body").to_bytes())
        });
        Some((answer.0, String::from_utf8_lossy(&answer.1).into_owned()))
    }
}

impl Board {
    fn begin(&self) -> String {
        let (_, begun) = self.ask("POST", "/api/v1/submissions", WISH.as_bytes()).expect("a request");
        id_in(&begun).expect("a submission").to_owned()
    }

    fn remove(&self, id: &str) {
        let id = id.parse().expect("an id");
        self.runtime.block_on(self.store.remove_submission(id)).expect("it is there");
    }
}

fn id_in(answer: &str) -> Option<&str> {
    answer.strip_prefix("{\"id\":\"")?.get(..16)
}

fuzz_target!(init: if let Some((folder, _)) = seeds_wanted() {
    let begin = format!("POST /api/v1/submissions\n{WISH}");
    let all = SEEDS.into_iter().map(str::to_owned).chain([begin]).enumerate();
    write_seeds(&folder, all.map(|(number, seed)| (number.to_string(), seed.into_bytes())));
}, |data: &[u8]| {
    let Some(end) = data.iter().position(|byte| *byte == b'\n') else { return };
    let Some((method, address)) = std::str::from_utf8(&data[..end]).ok().and_then(|line| line.split_once(' ')) else {
        return;
    };
    let board = &*BOARD;
    let address = address.replacen('@', &board.id, 4);
    let Some((status, answer)) = board.ask(method, &address, &data[end + 1..]) else { return };
    assert!(!status.is_server_error(), "{status} to {method} {address}: {answer}");
    // An account may have few of them open at once, and what was changed is made anew.
    if status == StatusCode::CREATED {
        board.remove(id_in(&answer).expect("an id"));
    }
    if method != "GET" && status.is_success() && address.contains(&board.id) {
        board.remove(&board.id);
        assert_eq!(board.begin(), board.id);
    }
});
