//! A small server of S3's protocol on loopback, for tests: one bucket in memory, or in a folder, where it outlives its process. It refuses
//! what is not signed with its key, and parts that S3 would refuse.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader, Read as _, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use data_encoding::HEXLOWER;
use ring::hmac;
use sha2::{Digest as _, Sha256};

const KEY: &str = "test-key";
const SECRET: &str = "test-secret";
/// S3 takes no smaller part but the last.
const MIN_PART: usize = 5 << 20;

/// A server that ends with its process.
pub struct Server {
    address: SocketAddr,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    bucket: String,
    /// Each object is a file in it as soon as it is acknowledged.
    folder: Option<PathBuf>,
    objects: Mutex<BTreeMap<String, Vec<u8>>>,
    /// Parts by upload and number.
    uploads: Mutex<BTreeMap<u64, BTreeMap<u64, Vec<u8>>>>,
    requests: AtomicU64,
    /// Every request fails, as of a server that is away.
    is_away: AtomicBool,
}

struct Request {
    method: String,
    path: String,
    query: BTreeMap<String, String>,
    headers: BTreeMap<String, String>,
    body: Vec<u8>,
}

type Answer = (u16, Vec<(&'static str, String)>, Vec<u8>);

impl Server {
    pub fn start(bucket: &str) -> Self {
        Self::serve(0, State { bucket: bucket.into(), ..State::default() })
    }

    /// One that has the objects of a folder, at this port. Parts of incomplete uploads are lost with it.
    pub fn start_in(folder: &Path, bucket: &str, port: u16) -> Self {
        std::fs::create_dir_all(folder).unwrap();
        let files = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
        let object = |path: PathBuf| {
            let key = HEXLOWER.decode(path.file_name()?.as_encoded_bytes()).ok()?;
            Some((String::from_utf8(key).unwrap(), std::fs::read(&path).unwrap()))
        };
        let objects = Mutex::new(files.filter_map(object).collect());
        Self::serve(port, State { bucket: bucket.into(), folder: Some(folder.into()), objects, ..State::default() })
    }

    fn serve(port: u16, state: State) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", port)).unwrap();
        let state = Arc::new(state);
        let server = Self { address: listener.local_addr().unwrap(), state: Arc::clone(&state) };
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let state = Arc::clone(&state);
                std::thread::spawn(move || drop(serve(&state, stream)));
            }
        });
        server
    }

    /// Variables with which Amazon's programs find it.
    pub fn environment(&self) -> [(&'static str, String); 5] {
        Self::environment_at(self.address.port())
    }

    /// The same for one at that port.
    pub fn environment_at(port: u16) -> [(&'static str, String); 5] {
        [
            ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{port}")),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_ACCESS_KEY_ID", KEY.into()),
            ("AWS_SECRET_ACCESS_KEY", SECRET.into()),
        ]
    }

    pub fn requests(&self) -> u64 {
        self.state.requests.load(Ordering::Relaxed)
    }

    pub fn set_away(&self, is_away: bool) {
        self.state.is_away.store(is_away, Ordering::Relaxed);
    }

    /// Keys and contents of all objects.
    pub fn objects(&self) -> BTreeMap<String, Vec<u8>> {
        self.state.objects.lock().unwrap().clone()
    }

    /// Changes an object behind everybody's back.
    pub fn set(&self, key: &str, content: &[u8]) {
        self.state.objects.lock().unwrap().insert(key.into(), content.into());
    }
}

impl State {
    /// The file of an object; none where they are in memory alone.
    fn file(&self, key: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(HEXLOWER.encode(key.as_bytes())))
    }

    fn put(&self, objects: &mut BTreeMap<String, Vec<u8>>, key: &str, content: Vec<u8>) {
        if let Some(file) = self.file(key) {
            let part = file.with_extension("part");
            std::fs::write(&part, &content).and_then(|()| std::fs::rename(&part, &file)).unwrap();
        }
        objects.insert(key.into(), content);
    }
}

fn serve(state: &State, stream: TcpStream) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut writer = stream;
    while let Some(request) = read(&mut reader)? {
        state.requests.fetch_add(1, Ordering::Relaxed);
        if state.is_away.load(Ordering::Relaxed) {
            return Ok(());
        }
        let (status, headers, body) =
            if is_signed(&request) { answer(state, &request) } else { refused(403, "SignatureDoesNotMatch") };
        let mut head = format!("HTTP/1.1 {status} X\r\n");
        for (name, value) in headers {
            write!(head, "{name}: {value}\r\n").unwrap();
        }
        if request.method != "HEAD" || status != 200 {
            write!(head, "Content-Length: {}\r\n", body.len()).unwrap();
        }
        writer.write_all((head + "\r\n").as_bytes())?;
        if request.method != "HEAD" {
            writer.write_all(&body)?;
        }
    }
    Ok(())
}

fn read(reader: &mut BufReader<TcpStream>) -> std::io::Result<Option<Request>> {
    let mut line = String::new();
    if reader.read_line(&mut line)? == 0 {
        return Ok(None);
    }
    let mut words = line.split(' ');
    let (method, target) = (words.next().unwrap().to_owned(), words.next().unwrap().to_owned());
    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    let pair = |text: &str| {
        let (name, value) = text.split_once('=').unwrap_or((text, ""));
        (name.to_owned(), value.to_owned())
    };
    let query = query.split('&').filter(|text| !text.is_empty()).map(pair).collect();
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let Some((name, value)) = line.trim_end().split_once(':') else { break };
        headers.insert(name.to_ascii_lowercase(), value.trim().to_owned());
    }
    let length = headers.get("content-length").map_or(0, |text| text.parse().unwrap());
    let mut body = vec![0; length];
    reader.read_exact(&mut body)?;
    Ok(Some(Request { method, path: path.into(), query, headers, body }))
}

/// True if the request has the signature of version 4 that Amazon describes, of its own body.
fn is_signed(request: &Request) -> bool {
    let header = |name: &str| request.headers.get(name).map_or("", String::as_str);
    let field = |name: &str| {
        let fields = header("authorization").strip_prefix("AWS4-HMAC-SHA256 ").unwrap_or_default().split(", ");
        fields
            .filter_map(|field| field.split_once('='))
            .find(|(known, _)| *known == name)
            .map_or("", |(_, value)| value)
    };
    let Some(scope) = field("Credential").strip_prefix(KEY).and_then(|scope| scope.strip_prefix('/')) else {
        return false;
    };
    let content = header("x-amz-content-sha256");
    if content != HEXLOWER.encode(&Sha256::digest(&request.body)) || !field("SignedHeaders").contains("host") {
        return false;
    }
    let query: Vec<String> = request.query.iter().map(|(name, value)| format!("{name}={value}")).collect();
    let mut canonical = format!("{}\n{}\n{}\n", request.method, request.path, query.join("&"));
    for name in field("SignedHeaders").split(';') {
        writeln!(canonical, "{name}:{}", header(name)).unwrap();
    }
    write!(canonical, "\n{}\n{content}", field("SignedHeaders")).unwrap();
    let hash = HEXLOWER.encode(&Sha256::digest(&canonical));
    let text = format!("AWS4-HMAC-SHA256\n{}\n{scope}\n{hash}", header("x-amz-date"));
    let sign =
        |key: &[u8], text: &str| hmac::sign(&hmac::Key::new(hmac::HMAC_SHA256, key), text.as_bytes()).as_ref().to_vec();
    let key = scope.split('/').fold(format!("AWS4{SECRET}").into_bytes(), |key, part| sign(&key, part));
    HEXLOWER.encode(&sign(&key, &text)) == field("Signature")
}

fn answer(state: &State, request: &Request) -> Answer {
    let Some(key) = request.path.strip_prefix(&format!("/{}/", state.bucket)) else {
        return refused(404, "NoSuchBucket");
    };
    let mut objects = state.objects.lock().unwrap();
    let upload = request.query.get("uploadId").and_then(|id| id.parse().ok());
    let mut uploads = state.uploads.lock().unwrap();
    match (request.method.as_str(), upload) {
        ("POST", None) if request.query.contains_key("uploads") => {
            let id = state.requests.load(Ordering::Relaxed);
            uploads.insert(id, BTreeMap::new());
            xml(&format!("<InitiateMultipartUploadResult><UploadId>{id}</UploadId></InitiateMultipartUploadResult>"))
        }
        ("PUT", Some(id)) => {
            let (Some(parts), Some(number)) = (uploads.get_mut(&id), request.query.get("partNumber")) else {
                return refused(404, "NoSuchUpload");
            };
            parts.insert(number.parse().unwrap(), request.body.clone());
            (200, vec![("ETag", etag(&request.body))], Vec::new())
        }
        ("POST", Some(id)) => {
            let Some(parts) = uploads.get(&id) else { return refused(404, "NoSuchUpload") };
            if parts.values().rev().skip(1).any(|part| part.len() < MIN_PART) {
                return refused(400, "EntityTooSmall");
            }
            let whole: Vec<u8> = parts.values().flatten().copied().collect();
            let tag = etag(&whole);
            state.put(&mut objects, key, whole);
            uploads.remove(&id);
            xml(&format!("<CompleteMultipartUploadResult><ETag>{tag}</ETag></CompleteMultipartUploadResult>"))
        }
        ("DELETE", Some(id)) => {
            uploads.remove(&id);
            (204, Vec::new(), Vec::new())
        }
        ("PUT", None) => {
            state.put(&mut objects, key, request.body.clone());
            (200, vec![("ETag", etag(&request.body))], Vec::new())
        }
        ("GET" | "HEAD", None) => {
            let Some(found) = objects.get(key) else { return refused(404, "NoSuchKey") };
            let mut headers = vec![("ETag", etag(found)), ("Last-Modified", "Thu, 01 Jan 2026 00:00:00 GMT".into())];
            if request.method == "HEAD" {
                headers.push(("Content-Length", found.len().to_string()));
            }
            (200, headers, found.clone())
        }
        ("DELETE", None) => {
            objects.remove(key);
            if let Some(file) = state.file(key) {
                drop(std::fs::remove_file(file));
            }
            (204, Vec::new(), Vec::new())
        }
        _ => refused(501, "NotImplemented"),
    }
}

fn etag(content: &[u8]) -> String {
    format!("\"{}\"", HEXLOWER.encode(&Sha256::digest(content)[..16]))
}

fn xml(text: &str) -> Answer {
    (200, vec![("Content-Type", "application/xml".into())], format!("<?xml version=\"1.0\"?>{text}").into_bytes())
}

fn refused(status: u16, code: &str) -> Answer {
    (status, Vec::new(), format!("<Error><Code>{code}</Code><Message>{code}</Message></Error>").into_bytes())
}
