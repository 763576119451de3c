//! The page over HTTP, on 127.0.0.1 alone: of a finished run (`view`), or of one that works
//! (`--view`). A few kinds of address are answered; no path leads to a file.

use super::http::{HttpRequest, HttpResponse, Limits, OpenConnections};
use super::watch::Watch;
use super::{Run, browser, bundle, check_bundle, page};
use crate::args::ViewArgs;
use crate::cut::CutConfig;
use crate::outcome::Outcome;
use crate::terminal::{CANCELLED, say};
use anyhow::{Context, Result, anyhow};
use std::fs::File;
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// What an address stands for.
#[derive(Debug, PartialEq, Eq)]
enum Answer {
    Page,
    Script,
    Scene,
    Status,
    Splat,
    /// The splat without what was cut away: as `.ply`, or as the page shows it.
    Cut {
        is_file: bool,
    },
    Photo(usize),
    Frame(usize),
    Matte(usize),
    Report,
    Nothing,
}

/// Serves a finished run until Ctrl-C.
pub fn run(args: &ViewArgs, quiet: bool) -> Result<Outcome> {
    check_bundle()?;
    let (server, served) = listen(Arc::new(Watch::finished(Run::open(&args.run)?)), args.port)?;
    if !quiet {
        say(&format!("open {} in a browser; Ctrl-C ends", served.address()));
    }
    serve(&server, &Arc::new(served));
    Ok(Outcome::Done)
}

/// A run that is served while it works.
pub(crate) struct Serving {
    watch: Arc<Watch>,
    address: String,
}

impl Serving {
    /// Serves what is told to `watch`, opens the browser or says where the page is.
    pub(crate) fn start(watch: Arc<Watch>) -> Result<Self> {
        check_bundle()?;
        let (server, served) = listen(Arc::clone(&watch), 0)?;
        let address = served.address();
        let served = Arc::new(served);
        let thread = std::thread::Builder::new().spawn(move || serve(&server, &served));
        thread.context("cannot serve the page")?;
        let opened = browser::open(&address);
        say(&format!("{} {address}", if opened { "watch in the browser:" } else { "to watch, open" }));
        Ok(Self { watch, address })
    }

    /// What the page is told.
    pub(crate) fn watch(&self) -> &Arc<Watch> {
        &self.watch
    }

    /// Stays until the page is closed, or Ctrl-C.
    pub(crate) fn linger(&self) {
        if self.watch.is_looked_at() {
            say(&format!("{} stays until its page is closed; Ctrl-C ends at once", self.address));
        }
        while self.watch.is_looked_at() && !CANCELLED.load(Ordering::Relaxed) {
            std::thread::sleep(WAIT);
        }
    }
}

/// How long Ctrl-C may go unseen. Source: chosen by hand: an eye blinks as fast.
const WAIT: Duration = Duration::from_millis(200);

/// Begins to listen on this machine's own address.
fn listen(watch: Arc<Watch>, port: u16) -> Result<(TcpListener, Served)> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let listener = TcpListener::bind(address)
        .map_err(|e| anyhow!("cannot listen on {address}: {e}; choose another port with --port"))?;
    let port = listener.local_addr().context("cannot listen")?.port();
    listener.set_nonblocking(true).context("cannot listen")?;
    Ok((listener, Served { watch, script: bundle()?, port }))
}

/// Answers until Ctrl-C.
fn serve(listener: &TcpListener, served: &Arc<Served>) {
    let open = Arc::new(OpenConnections::default());
    while !CANCELLED.load(Ordering::Relaxed) {
        match listener.accept() {
            Ok((stream, _)) => attend(stream, &open, served),
            // Nobody asks, somebody has gone away, or too many files are open.
            Err(_) => std::thread::sleep(PAUSE),
        }
    }
}

/// Time between two looks for new connections. Source: derived; nobody notices a fiftieth of a
/// second.
const PAUSE: Duration = Duration::from_millis(20);

/// Answers a connection in a thread of its own.
fn attend(stream: TcpStream, open: &Arc<OpenConnections>, served: &Arc<Served>) {
    let mut refused = stream.try_clone().ok();
    let connection = stream.set_nonblocking(false).ok().and_then(|()| open.admit(stream, Limits::default()));
    let Some(connection) = connection else {
        // It fits into the buffers of the system, or is lost.
        let said = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        let _ = refused.as_mut().map(|stream| stream.write(said));
        return;
    };
    let served = Arc::clone(served);
    // A browser that has gone away is no error of ours; nor is a thread that the system refuses,
    // which closes the connection.
    let _ = std::thread::Builder::new().spawn(move || drop(connection.serve(|r| answer(r, &served))));
}

/// What is served.
struct Served {
    watch: Arc<Watch>,
    script: String,
    port: u16,
}

impl Served {
    fn address(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// The page as things are now.
    fn page(&self) -> Result<String> {
        let (scene, version, live) = self.watch.scene();
        let script = format!(
            r#"<script src="viewer.js" data-served="{version}" data-live="{}"></script>"#,
            u8::from(live)
        );
        page(&scene, "", &script)
    }

    /// What a cut leaves of the trained splat.
    fn cut(&self, query: &str, is_file: bool) -> Result<Vec<u8>> {
        let cut = CutConfig::of_query(query)?;
        let mut gaussians = self.watch.trained()?;
        cut.apply(&mut gaussians);
        if is_file {
            return scene::io::ply::encode_splat_ply(&gaussians).map_err(anyhow::Error::msg);
        }
        self.watch.encode(gaussians)
    }
}

/// What the page may do: run the served script alone, with the decoder of splats that it brings
/// along (WebAssembly, in workers), and load nothing from anywhere else. A name out of a file that
/// found its way into the page could not run.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src blob:; \
    connect-src 'self' blob: data:; img-src 'self' blob: data:; style-src 'unsafe-inline'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What the report may do: it is one file with its own script and pictures in it, and fetches
/// nothing.
const REPORT_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; img-src data:; \
    style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Why a request is not answered.
fn refusal(request: &HttpRequest, port: u16) -> Option<HttpResponse<'static>> {
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    // A page of another site that resolves its name to this machine sends its own name.
    let is_local = request.header("Host").is_some_and(|h| own.iter().any(|o| o.as_bytes() == h));
    // Other sites may link to the page, but not load what is in it.
    let is_foreign = request.header("Sec-Fetch-Site") == Some(b"cross-site");
    if !is_local || (is_foreign && route(&request.target) != Answer::Page) {
        return Some(HttpResponse::plain(403, "forbidden"));
    }
    let is_read = matches!(request.method.as_str(), "GET" | "HEAD");
    let refused = || HttpResponse::plain(405, "only GET and HEAD are answered").with("Allow", "GET, HEAD");
    (!is_read).then(refused)
}

const HTML: &str = "text/html; charset=utf-8";
const BINARY: &str = "application/octet-stream";

fn answer<'a>(request: &HttpRequest, served: &'a Served) -> HttpResponse<'a> {
    if let Some(refused) = refusal(request, served.port) {
        return refused;
    }
    let (watch, url) = (&served.watch, request.target.as_str());
    let query = url.split_once('?').map_or("", |(_, query)| query);
    match route(url) {
        Answer::Page => match served.page() {
            Ok(text) => HttpResponse::found(HTML, text.into_bytes()).with("Content-Security-Policy", POLICY),
            Err(error) => HttpResponse::plain(500, format!("{error:#}")),
        },
        Answer::Script => HttpResponse::found("text/javascript; charset=utf-8", served.script.as_bytes()),
        Answer::Scene => data(serde_json::to_vec(&watch.scene().0), "application/json"),
        Answer::Status => data(watch.status().map(String::into_bytes), "application/json"),
        Answer::Splat => match watch.splat() {
            Some(splat) => HttpResponse::found(BINARY, splat.to_vec()),
            None => HttpResponse::plain(404, "not found"),
        },
        Answer::Cut { is_file } => data(served.cut(query, is_file), BINARY),
        Answer::Photo(index) => file(watch.photo(index)),
        Answer::Frame(index) => picture(watch.thumbnail(index, false)),
        Answer::Matte(index) => picture(watch.thumbnail(index, true)),
        Answer::Report => match std::fs::read(watch.folder().join("report.html")) {
            Ok(report) => HttpResponse::found(HTML, report).with("Content-Security-Policy", REPORT_POLICY),
            Err(_) => HttpResponse::plain(404, "not found"),
        },
        Answer::Nothing => HttpResponse::plain(404, "not found"),
    }
}

/// What was made for a request, or why it could not be.
fn data<E: std::fmt::Display>(made: Result<Vec<u8>, E>, content: &'static str) -> HttpResponse<'static> {
    match made {
        Ok(bytes) => HttpResponse::found(content, bytes).with("Cache-Control", "no-store"),
        Err(error) => HttpResponse::plain(400, format!("{error:#}")),
    }
}

/// A small picture; its address has another number when the picture is another one.
fn picture(jpeg: Option<Vec<u8>>) -> HttpResponse<'static> {
    match jpeg {
        Some(jpeg) => HttpResponse::found("image/jpeg", jpeg).with("Cache-Control", "max-age=3600"),
        None => HttpResponse::plain(404, "not found"),
    }
}

fn file(path: Option<PathBuf>) -> HttpResponse<'static> {
    match path.and_then(|p| File::open(p).ok()) {
        Some(file) => HttpResponse::file(BINARY, file),
        None => HttpResponse::plain(404, "not found"),
    }
}

/// Only these addresses exist, spelt exactly so.
fn route(url: &str) -> Answer {
    match url.split('?').next().unwrap_or("") {
        "/" => Answer::Page,
        "/viewer.js" => Answer::Script,
        "/scene.json" => Answer::Scene,
        "/status.json" => Answer::Status,
        "/splat.spz" => Answer::Splat,
        "/cut.ply" => Answer::Cut { is_file: true },
        "/cut.spz" => Answer::Cut { is_file: false },
        "/report.html" => Answer::Report,
        path => {
            let numbered = [
                ("/photo/", Answer::Photo as fn(usize) -> Answer),
                ("/frame/", Answer::Frame),
                ("/matte/", Answer::Matte),
            ];
            let found = numbered.into_iter().find_map(|(start, of)| Some((path.strip_prefix(start)?, of)));
            match found {
                Some((digits, of)) if digits.bytes().all(|b| b.is_ascii_digit()) => {
                    digits.parse().map_or(Answer::Nothing, of)
                }
                _ => Answer::Nothing,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_known_addresses_are_answered() {
        assert_eq!(route("/"), Answer::Page);
        assert_eq!(route("/viewer.js"), Answer::Script);
        assert_eq!(route("/splat.spz?x=1"), Answer::Splat);
        assert_eq!(route("/photo/3"), Answer::Photo(3));
        assert_eq!(route("/matte/12?v=2"), Answer::Matte(12));
        assert_eq!(route("/cut.ply?box=0,0,0,1,1,1"), Answer::Cut { is_file: true });
        for url in [
            "/../etc/passwd",
            "/photo/..%2f1",
            "/photo/-1",
            "/photo/+1",
            "/photo/",
            "//etc",
            "/photo/1/../2",
            "/frame/1.png",
            "/matte/",
            "/status.json/",
            "/splat.spz/",
            "/splat.ply",
            "",
        ] {
            assert_eq!(route(url), Answer::Nothing, "{url}");
        }
    }
}
