//! `view`: the page over HTTP, on 127.0.0.1 alone. Five kinds of address are answered; no path
//! leads to a file.

use super::http::{HttpRequest, HttpResponse, Limits, OpenConnections};
use super::{Run, Splat, bundle, check_bundle, page};
use crate::args::ViewArgs;
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
    Splat,
    Photo(usize),
    Nothing,
}

/// Serves until Ctrl-C.
pub fn run(args: &ViewArgs, quiet: bool) -> Result<Outcome> {
    check_bundle()?;
    let run = Run::open(&args.run)?;
    let scene = run.scene(Splat { url: Some("splat.spz") }, |i| run.photo(i).map(|_| format!("photo/{i}")));
    let page = page(&scene, "", r#"<script src="viewer.js"></script>"#)?;
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let listener = TcpListener::bind(address)
        .map_err(|e| anyhow!("cannot listen on {address}: {e}; choose another port with --port"))?;
    let port = listener.local_addr().context("cannot listen")?.port();
    listener.set_nonblocking(true).context("cannot listen")?;
    if !quiet {
        say(&format!("open http://127.0.0.1:{port} in a browser; Ctrl-C ends"));
    }
    let served = Arc::new(Served { run, page, script: bundle()?, port });
    let open = Arc::new(OpenConnections::default());
    while !CANCELLED.load(Ordering::Relaxed) {
        match listener.accept() {
            Ok((stream, _)) => serve(stream, &open, &served),
            // Nobody asks, somebody has gone away, or too many files are open.
            Err(_) => std::thread::sleep(PAUSE),
        }
    }
    Ok(Outcome::Done)
}

/// Time between two looks for new connections. Source: derived; nobody notices a fiftieth of a
/// second.
const PAUSE: Duration = Duration::from_millis(20);

/// Answers a connection in a thread of its own.
fn serve(stream: TcpStream, open: &Arc<OpenConnections>, served: &Arc<Served>) {
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
    run: Run,
    page: String,
    script: String,
    port: u16,
}

/// What the page may do: run the served script alone, with the decoder of splats that it brings
/// along (WebAssembly, in workers), and load nothing from anywhere else. A name out of a file that
/// found its way into the page could not run.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src blob:; \
    connect-src 'self' blob: data:; img-src 'self' blob: data:; style-src 'unsafe-inline'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

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

fn answer<'a>(request: &HttpRequest, Served { run, page, script, port }: &'a Served) -> HttpResponse<'a> {
    if let Some(refused) = refusal(request, *port) {
        return refused;
    }
    match route(&request.target) {
        Answer::Page => HttpResponse::found("text/html; charset=utf-8", page.as_bytes())
            .with("Content-Security-Policy", POLICY),
        Answer::Script => HttpResponse::found("text/javascript; charset=utf-8", script.as_bytes()),
        Answer::Splat => HttpResponse::found(BINARY, &run.splat),
        Answer::Photo(index) => file(run.photo(index)),
        Answer::Nothing => HttpResponse::plain(404, "not found"),
    }
}

const BINARY: &str = "application/octet-stream";

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
        "/splat.spz" => Answer::Splat,
        path => match path.strip_prefix("/photo/") {
            Some(digits) if digits.bytes().all(|b| b.is_ascii_digit()) => {
                digits.parse().map_or(Answer::Nothing, Answer::Photo)
            }
            _ => Answer::Nothing,
        },
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
        for url in [
            "/../etc/passwd",
            "/photo/..%2f1",
            "/photo/-1",
            "/photo/+1",
            "/photo/",
            "//etc",
            "/photo/1/../2",
            "/splat.spz/",
            "/splat.ply",
            "",
        ] {
            assert_eq!(route(url), Answer::Nothing, "{url}");
        }
    }
}
