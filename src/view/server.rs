//! `view`: the page over HTTP, on 127.0.0.1 alone. Five kinds of address are answered; no path
//! leads to a file.

use super::{Run, Splat, bundle, check_bundle, page};
use crate::args::ViewArgs;
use crate::outcome::Outcome;
use crate::terminal::{CANCELLED, say};
use anyhow::{Result, anyhow};
use std::fs::File;
use std::io::Cursor;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tiny_http::{Header, Method, Request, Response, Server};

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
    let server = Server::http(address)
        .map_err(|e| anyhow!("cannot listen on {address}: {e}; choose another port with --port"))?;
    let port = server.server_addr().to_ip().map_or(args.port, |a| a.port());
    if !quiet {
        say(&format!("open http://127.0.0.1:{port} in a browser; Ctrl-C ends"));
    }
    let served = Arc::new(Served { run, page, script: bundle()?, port });
    while !CANCELLED.load(Ordering::Relaxed) {
        let Some(request) = server.recv_timeout(Duration::from_millis(200))? else { continue };
        // A client that does not read its answer keeps its own thread waiting and nobody else.
        if Arc::strong_count(&served) > AT_ONCE {
            let _ = request.respond(plain("too many requests at once", 503)); // nor is one that has gone away
            continue;
        }
        let served = Arc::clone(&served);
        // A browser that has gone away is no error of ours.
        let thread = std::thread::Builder::new().spawn(move || drop(answer(request, &served)));
        thread.map_err(|e| anyhow!("cannot answer a request: {e}"))?;
    }
    Ok(Outcome::Done)
}

/// Requests that are answered at the same time. Source: derived; a browser asks for six, and a page
/// in every window of a desktop.
const AT_ONCE: usize = 64;

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

/// Why a request is not answered: the words, the status code.
fn refusal(request: &Request, port: u16) -> Option<(&'static str, u16)> {
    let header = |name: &'static str| request.headers().iter().find(|h| h.field.equiv(name));
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    // A page of another site that resolves its name to this machine sends its own name.
    let is_local = header("Host").is_some_and(|h| own.iter().any(|o| o == h.value.as_str()));
    // Other sites may link to the page, but not load what is in it.
    let is_foreign = header("Sec-Fetch-Site").is_some_and(|h| h.value.as_str() == "cross-site");
    if !is_local || (is_foreign && route(request.url()) != Answer::Page) {
        return Some(("forbidden", 403));
    }
    let is_read = matches!(request.method(), Method::Get | Method::Head);
    (!is_read).then_some(("only GET and HEAD are answered", 405))
}

fn plain(text: &str, status: u16) -> Response<Cursor<Vec<u8>>> {
    let response = of_kind(Response::from_string(text), "text/plain; charset=utf-8").with_status_code(status);
    if status == 405 { with(response, "Allow", "GET, HEAD") } else { response }
}

fn answer(request: Request, Served { run, page, script, port }: &Served) -> std::io::Result<()> {
    if let Some((text, status)) = refusal(&request, *port) {
        return request.respond(plain(text, status));
    }
    match route(request.url()) {
        Answer::Page => {
            let page = of_kind(Response::from_string(page), "text/html; charset=utf-8");
            request.respond(with(page, "Content-Security-Policy", POLICY))
        }
        Answer::Script => {
            request.respond(of_kind(Response::from_string(script), "text/javascript; charset=utf-8"))
        }
        Answer::Splat => {
            request.respond(of_kind(Response::from_data(&*run.splat), "application/octet-stream"))
        }
        Answer::Photo(index) => file(request, run.photo(index), "application/octet-stream"),
        Answer::Nothing => request.respond(plain("not found", 404)),
    }
}

fn file(request: Request, path: Option<PathBuf>, content: &str) -> std::io::Result<()> {
    match path.and_then(|p| File::open(p).ok()) {
        Some(file) => request.respond(of_kind(Response::from_file(file), content)),
        None => request.respond(plain("not found", 404)),
    }
}

/// Says what an answer is, which is not to be guessed.
fn of_kind<R: std::io::Read>(response: Response<R>, content: &str) -> Response<R> {
    with(with(response, "Content-Type", content), "X-Content-Type-Options", "nosniff")
}

/// Adds a header; names and values are constants that always parse.
fn with<R: std::io::Read>(mut response: Response<R>, name: &str, value: &str) -> Response<R> {
    if let Ok(header) = Header::from_bytes(name, value) {
        response.add_header(header);
    }
    response
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
