//! Counts the requests and bytes of each command, including repeated requests.

use std::cell::Cell;
use std::future::Future;

use async_trait::async_trait;
use object_store::client::{
    ClientOptions, HttpClient, HttpConnector, HttpError, HttpRequest, HttpResponse, HttpService,
    ReqwestConnector,
};
use serde::Serialize;

/// The cost of a command. Services charge more for writing and listing than for reading.
#[derive(Debug, Default, Clone, Copy, Serialize)]
pub struct Cost {
    /// GET and HEAD requests.
    pub reads: u64,
    /// PUT, POST and LIST requests.
    pub writes: u64,
    /// DELETE requests.
    pub deletes: u64,
    /// Bytes of sent bodies.
    pub sent: u64,
    /// Bytes of received bodies.
    pub received: u64,
}

tokio::task_local! {
    static COST: Cell<Cost>;
}

/// Runs a command and returns its result and cost.
pub async fn measure<T>(work: impl Future<Output = T>) -> (T, Cost) {
    let run = async {
        let result = work.await;
        (result, COST.with(Cell::get))
    };
    COST.scope(Cell::default(), run).await
}

fn count(change: impl FnOnce(&mut Cost)) {
    // Requests for credentials may run outside of a command.
    let _ = COST.try_with(|cell| {
        let mut cost = cell.get();
        change(&mut cost);
        cell.set(cost);
    });
}

/// Counts the bytes of a body that was received.
pub fn count_received(bytes: usize) {
    count(|cost| cost.received += bytes as u64);
}

#[derive(Debug)]
struct Counting(HttpClient);

#[async_trait]
impl HttpService for Counting {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let sent = request.body().content_length() as u64;
        let list = request
            .uri()
            .query()
            .is_some_and(|q| q.contains("list-type"));
        let method = request.method().clone();
        count(|cost| {
            cost.sent += sent;
            match method.as_str() {
                "GET" | "HEAD" if !list => cost.reads += 1,
                "DELETE" => cost.deletes += 1,
                _ => cost.writes += 1,
            }
        });
        self.0.execute(request).await
    }
}

/// Creates clients that count.
#[derive(Debug)]
pub struct CountingConnector;

impl HttpConnector for CountingConnector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let client = ReqwestConnector::default().connect(options)?;
        Ok(HttpClient::new(Counting(client)))
    }
}
