//! Figures of the server in the text format of Prometheus.

use std::fmt::Write as _;
use std::net::{SocketAddr, TcpListener};

use anyhow::Context;
use axum::Router;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use fiatlux_cli::{PROMETHEUS_TEXT, metric_head};
use fiatlux_server::Counts;

/// An address for `/metrics`, and for nothing else.
pub struct Metrics(TcpListener);

impl Metrics {
    /// Takes the address, before anything else is started.
    pub fn bind(address: SocketAddr) -> anyhow::Result<Self> {
        let taken = || format!("--metrics {address}: the address cannot be used; choose another port");
        let listener = TcpListener::bind(address).with_context(taken)?;
        listener.set_nonblocking(true)?;
        tracing::info!("metrics are on http://{}/metrics", listener.local_addr()?);
        Ok(Self(listener))
    }

    /// Answers on a thread of its own for as long as the process runs.
    pub fn serve(self, counts: impl Fn() -> Option<Counts> + Clone + Send + Sync + 'static) -> anyhow::Result<()> {
        let page = move || {
            let counts = counts();
            async move {
                match counts {
                    Some(counts) => ([(header::CONTENT_TYPE, PROMETHEUS_TEXT)], text(&counts)).into_response(),
                    None => StatusCode::SERVICE_UNAVAILABLE.into_response(),
                }
            }
        };
        let router = Router::new().route("/metrics", get(page));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let answer = move || {
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::from_std(self.0)?;
                axum::serve(listener, router).await
            })
        };
        std::thread::Builder::new().name("metrics".into()).spawn(answer)?;
        Ok(())
    }
}

fn text(counts: &Counts) -> String {
    let mut out = String::new();
    let one = |value: u64| vec![("", value)];
    let figures = [
        ("server_sessions_open", "gauge", "Sessions that are open now.", one(counts.open_sessions as u64)),
        ("server_sessions_capacity", "gauge", "Sessions that can be open at once.", one(counts.capacity as u64)),
        ("server_sessions_total", "counter", "Sessions that were opened.", one(counts.sessions)),
        (
            "server_records_total",
            "counter",
            "Records of sessions, one for each control step and few others.",
            one(counts.records),
        ),
        (
            "server_refused_messages_total",
            "counter",
            "Messages that did not come from a session's client, or came twice.",
            one(counts.refused_messages),
        ),
        (
            "server_bags_total",
            "counter",
            "Bags that the server's own recorder finished or had to cut.",
            vec![("{end=\"whole\"}", counts.bags), ("{end=\"cut\"}", counts.cut_bags)],
        ),
    ];
    for (name, kind, help, values) in figures {
        metric_head(&mut out, name, kind, help);
        for (label, value) in values {
            let _ = writeln!(out, "fiatlux_{name}{label} {value}");
        }
    }
    out
}
