//! `view`: the page over HTTP, on 127.0.0.1 alone. Four kinds of address are answered; no path
//! leads to a file.

use super::{Run, Splat, check_bundle, page};
use crate::args::ViewArgs;
use crate::outcome::Outcome;
use crate::terminal::{CANCELLED, say};
use anyhow::{Result, anyhow};
use std::fs::File;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tiny_http::{Header, Method, Request, Response, Server};

/// What an address stands for.
#[derive(Debug, PartialEq, Eq)]
enum Answer {
    Page,
    Splat,
    Photo(usize),
    Nothing,
}

/// Serves until Ctrl-C.
pub fn run(args: &ViewArgs, quiet: bool) -> Result<Outcome> {
    check_bundle()?;
    let run = Run::open(&args.run)?;
    let scene = run.scene(Splat { url: Some("splat.spz") }, |i| run.photo(i).map(|_| format!("photo/{i}")));
    let page = page(&scene, "")?;
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let server = Server::http(address)
        .map_err(|e| anyhow!("cannot listen on {address}: {e}; choose another port with --port"))?;
    let port = server.server_addr().to_ip().map_or(args.port, |a| a.port());
    if !quiet {
        say(&format!("open http://127.0.0.1:{port} in a browser; Ctrl-C ends"));
    }
    while !CANCELLED.load(Ordering::Relaxed) {
        if let Some(request) = server.recv_timeout(Duration::from_millis(200))? {
            // A browser that has gone away is no error of ours.
            let _ = answer(request, &run, &page, port);
        }
    }
    Ok(Outcome::Done)
}

fn answer(request: Request, run: &Run, page: &str, port: u16) -> std::io::Result<()> {
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    // A page of another site that resolves its name to this machine sends its own name.
    let is_local =
        request.headers().iter().any(|h| h.field.equiv("Host") && own.iter().any(|o| o == h.value.as_str()));
    if !is_local || *request.method() != Method::Get {
        return request.respond(Response::from_string("forbidden").with_status_code(403));
    }
    match route(request.url()) {
        Answer::Page => request.respond(of_kind(Response::from_string(page), "text/html; charset=utf-8")),
        Answer::Splat => {
            request.respond(of_kind(Response::from_data(&*run.splat), "application/octet-stream"))
        }
        Answer::Photo(index) => file(request, run.photo(index), "application/octet-stream"),
        Answer::Nothing => request.respond(Response::from_string("not found").with_status_code(404)),
    }
}

fn file(request: Request, path: Option<PathBuf>, content: &str) -> std::io::Result<()> {
    match path.and_then(|p| File::open(p).ok()) {
        Some(file) => request.respond(of_kind(Response::from_file(file), content)),
        None => request.respond(Response::from_string("not found").with_status_code(404)),
    }
}

/// Says what an answer is; the names of kinds are constants that always parse.
fn of_kind<R: std::io::Read>(mut response: Response<R>, content: &str) -> Response<R> {
    if let Ok(header) = Header::from_bytes("Content-Type", content) {
        response.add_header(header);
    }
    response
}

/// Only these addresses exist, spelt exactly so.
fn route(url: &str) -> Answer {
    match url.split('?').next().unwrap_or("") {
        "/" => Answer::Page,
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
