//! HTTP/1.1 for a page on this machine: one request and one answer a connection (RFC 9112), within
//! limits of number, size and time, so that no client keeps others waiting.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Bytes that are read or written at once. Source: a buffer of std's `io::copy`.
const PIECE: usize = 8192;

/// What clients may take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Connections at the same time.
    pub connections: usize,
    /// Bytes of a request with its headers.
    pub request_bytes: usize,
    /// Headers of a request.
    pub headers: usize,
    /// Time for a request; and for an answer, beside the time that its bytes may take.
    pub time: Duration,
    /// Least speed with which an answer is taken, bytes a second.
    pub speed: f64,
    /// A connection on which nothing moved for so long gives way where there are too many.
    pub patience: Duration,
}

impl Default for Limits {
    /// A browser asks for six files at once, in each of a few windows, with headers of a few
    /// kilobytes; a splat of 10 MB may come through a tunnel of 1 Mbit/s.
    fn default() -> Self {
        Self {
            connections: 64,
            request_bytes: 32 << 10,
            headers: 100,
            time: Duration::from_secs(10),
            speed: 1e5,
            patience: Duration::from_secs(1),
        }
    }
}

/// A request: its first line and its headers.
#[derive(Debug, Default)]
pub(super) struct HttpRequest {
    pub method: String,
    pub target: String,
    headers: Vec<(String, Vec<u8>)>,
}

impl HttpRequest {
    /// The first header of that name.
    pub(super) fn header(&self, name: &str) -> Option<&[u8]> {
        let found = self.headers.iter().find(|(n, _)| n.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.as_slice())
    }

    /// Parses a whole head; `None` where more bytes are needed.
    ///
    /// # Errors
    /// The status code that says what is wrong: 400, or 431 for too many headers.
    fn parse(bytes: &[u8], limits: &Limits) -> std::result::Result<Option<Self>, u16> {
        let mut headers = vec![httparse::EMPTY_HEADER; limits.headers];
        let mut request = httparse::Request::new(&mut headers);
        let status = request.parse(bytes).map_err(|e| match e {
            httparse::Error::TooManyHeaders => 431,
            _ => 400_u16,
        })?;
        if status.is_partial() {
            return Ok(None);
        }
        let headers = request.headers.iter().map(|h| (h.name.to_owned(), h.value.to_vec())).collect();
        let [method, target] = [request.method, request.path].map(|text| text.unwrap_or("").to_owned());
        Ok(Some(Self { method, target, headers }))
    }
}

/// What an answer consists of.
enum Body<'a> {
    /// Bytes that are there.
    Bytes(Cow<'a, [u8]>),
    /// A file, as long as it was when it was opened.
    File(File, u64),
}

/// An answer.
pub(super) struct HttpResponse<'a> {
    status: u16,
    headers: Vec<(&'static str, &'static str)>,
    body: Body<'a>,
}

impl<'a> HttpResponse<'a> {
    /// Says what the answer is, which is not to be guessed.
    fn new(status: u16, content: &'static str, body: Body<'a>) -> Self {
        Self { status, headers: vec![("Content-Type", content), ("X-Content-Type-Options", "nosniff")], body }
    }

    /// What was asked for.
    pub(super) fn found(content: &'static str, bytes: impl Into<Cow<'a, [u8]>>) -> Self {
        Self::new(200, content, Body::Bytes(bytes.into()))
    }

    /// A line of text.
    pub(super) fn plain(status: u16, text: impl Into<String>) -> Self {
        Self::new(status, "text/plain; charset=utf-8", Body::Bytes(text.into().into_bytes().into()))
    }

    /// A file, as long as it is now.
    pub(super) fn file(content: &'static str, file: File) -> Self {
        match file.metadata() {
            Ok(metadata) => Self::new(200, content, Body::File(file, metadata.len())),
            Err(_) => Self::plain(404, "not found"),
        }
    }

    /// With one more header.
    pub(super) fn with(mut self, name: &'static str, value: &'static str) -> Self {
        self.headers.push((name, value));
        self
    }

    fn head(&self, length: u64) -> String {
        let lines = self.headers.iter().map(|(name, value)| format!("{name}: {value}\r\n"));
        let lines: String = lines.collect();
        let reason = match self.status {
            200 => "OK",
            400 => "Bad Request",
            403 => "Forbidden",
            404 => "Not Found",
            405 => "Method Not Allowed",
            408 => "Request Timeout",
            431 => "Request Header Fields Too Large",
            500 => "Internal Server Error",
            _ => "Service Unavailable",
        };
        let status = self.status;
        format!("HTTP/1.1 {status} {reason}\r\n{lines}Content-Length: {length}\r\nConnection: close\r\n\r\n")
    }
}

/// The connections that are open, and when something last moved on each.
#[derive(Default)]
pub(super) struct OpenConnections {
    all: Mutex<BTreeMap<u64, (TcpStream, Instant)>>,
    /// How many were taken in so far; the number of the next one.
    count: AtomicU64,
}

impl OpenConnections {
    /// Takes a connection in; `None` where there are too many, all of them busy. One on which
    /// nothing moved for a while is ended for it.
    pub(super) fn admit(self: &Arc<Self>, stream: TcpStream, limits: Limits) -> Option<Connection> {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        if all.len() >= limits.connections {
            let stillest =
                all.iter().min_by_key(|(_, (_, moved))| *moved).map(|(id, (_, moved))| (*id, *moved));
            let (id, moved) = stillest?;
            if moved.elapsed() < limits.patience {
                return None;
            }
            if let Some((stream, _)) = all.remove(&id) {
                let _ = stream.shutdown(Shutdown::Both); // its thread finds it closed
            }
        }
        let id = self.count.fetch_add(1, Ordering::Relaxed);
        all.insert(id, (stream.try_clone().ok()?, Instant::now()));
        let deadline = Instant::now() + limits.time;
        Some(Connection { id, stream, deadline, limits, open: Arc::clone(self) })
    }

    fn moved(&self, id: u64) {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, moved)) = all.get_mut(&id) {
            *moved = Instant::now();
        }
    }
}

/// One connection. Reading and writing end at a deadline, however slowly the other side goes on.
pub(super) struct Connection {
    id: u64,
    stream: TcpStream,
    deadline: Instant,
    limits: Limits,
    open: Arc<OpenConnections>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.open.all.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
    }
}

impl Connection {
    /// Reads the request, has it answered, and closes.
    ///
    /// # Errors
    /// If the client goes away or is too slow.
    pub(super) fn serve<'a>(mut self, answer: impl FnOnce(&HttpRequest) -> HttpResponse<'a>) -> Result<()> {
        let (request, response) = match self.request()? {
            Ok(request) => {
                let response = answer(&request);
                (request, response)
            }
            Err(status) => {
                (HttpRequest::default(), HttpResponse::plain(status, "not a request for this page"))
            }
        };
        self.respond(response, request.method == "HEAD")?;
        self.end()
    }

    /// The request, or the status code of what is wrong with it.
    fn request(&mut self) -> Result<std::result::Result<HttpRequest, u16>> {
        let mut bytes = Vec::new();
        let mut piece = [0; PIECE];
        loop {
            let read = match self.read(&mut piece) {
                Err(e) if e.kind() == ErrorKind::TimedOut => return Ok(Err(408)),
                read => read?,
            };
            if read == 0 {
                return Err(ErrorKind::UnexpectedEof.into());
            }
            bytes.extend_from_slice(&piece[..read]);
            if bytes.len() > self.limits.request_bytes {
                return Ok(Err(431));
            }
            match HttpRequest::parse(&bytes, &self.limits) {
                Ok(None) => {}
                Ok(Some(request)) => return Ok(Ok(request)),
                Err(status) => return Ok(Err(status)),
            }
        }
    }

    fn respond(&mut self, response: HttpResponse<'_>, is_head: bool) -> Result<()> {
        let length = match &response.body {
            Body::Bytes(bytes) => bytes.len() as u64,
            Body::File(_, length) => *length,
        };
        let time = self.limits.time + Duration::from_secs_f64(length as f64 / self.limits.speed);
        self.deadline = Instant::now() + time;
        self.write_all(response.head(length).as_bytes())?;
        match response.body {
            _ if is_head => Ok(()),
            Body::Bytes(bytes) => self.write_all(&bytes),
            Body::File(file, length) => std::io::copy(&mut file.take(length), self).map(drop),
        }
    }

    /// Closes in a way that lets the answer arrive: what the client still sends is read first (RFC
    /// 9112, 9.6).
    fn end(mut self) -> Result<()> {
        self.stream.shutdown(Shutdown::Write)?;
        self.deadline = Instant::now() + self.limits.patience;
        let mut piece = [0; PIECE];
        let mut left = self.limits.request_bytes;
        while left > 0 {
            match self.read(&mut piece)? {
                0 => break,
                read => left = left.saturating_sub(read),
            }
        }
        Ok(())
    }

    /// Time until the deadline.
    fn left(&self) -> Result<Duration> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

/// What systems say of a time limit.
fn timed_out(error: Error) -> Error {
    if error.kind() == ErrorKind::WouldBlock { ErrorKind::TimedOut.into() } else { error }
}

impl Read for Connection {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        let read = self.stream.read(buffer).map_err(timed_out)?;
        self.open.moved(self.id);
        Ok(read)
    }
}

impl Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        let written = self.stream.write(&bytes[..bytes.len().min(PIECE)]).map_err(timed_out)?;
        self.open.moved(self.id);
        Ok(written)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    const QUICK: Limits = Limits {
        connections: 3,
        request_bytes: 500,
        headers: 4,
        time: Duration::from_millis(400),
        speed: 1e9,
        patience: Duration::from_millis(100),
    };

    /// Serves `count` connections, each in a thread, with an answer of so many bytes; the port.
    fn serving(count: usize, bytes: usize, limits: Limits) -> u16 {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            let open = Arc::new(OpenConnections::default());
            for stream in listener.incoming().take(count) {
                let Some(connection) = open.admit(stream.unwrap(), limits) else { continue };
                std::thread::spawn(move || {
                    let body = vec![b'a'; bytes];
                    connection.serve(|_| HttpResponse::found("x/y", body))
                });
            }
        });
        port
    }

    fn connect(port: u16) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    fn asked(port: u16, request: &str) -> String {
        let mut stream = connect(port);
        stream.write_all(request.as_bytes()).unwrap();
        let mut said = String::new();
        let _ = stream.read_to_string(&mut said);
        said
    }

    const GET: &str = "GET / HTTP/1.1\r\n\r\n";

    #[test]
    fn a_request_is_answered_whole_and_what_is_too_much_of_one_is_refused() {
        // None of these is to end by its deadline, or to find those before it still open, on a
        // machine that is busy with others either.
        let limits = Limits { time: Duration::from_secs(20), connections: 6, ..QUICK };
        let port = serving(6, 100_000, limits);
        let said = asked(port, GET);
        assert!(said.starts_with("HTTP/1.1 200 OK\r\n") && said.ends_with(&"a".repeat(100_000)));
        let head = asked(port, "HEAD / HTTP/1.1\r\n\r\n");
        assert!(head.contains("Content-Length: 100000\r\n") && head.ends_with("\r\n\r\n"), "{head}");
        let long = format!("GET /{} HTTP/1.1\r\n\r\n", "b".repeat(600));
        assert!(asked(port, &long[..520]).starts_with("HTTP/1.1 431"));
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(5));
        assert!(asked(port, &many).starts_with("HTTP/1.1 431"));
        assert!(asked(port, "nonsense\r\n\r\n").starts_with("HTTP/1.1 400"));
        assert!(asked(port, "GET / HTTP/9.9\r\n\r\n").starts_with("HTTP/1.1 400"));
    }

    #[test]
    fn a_request_that_drips_and_an_answer_that_is_not_read_end_at_their_deadlines() {
        let port = serving(2, 50_000_000, QUICK);
        let begun = Instant::now();
        let mut slow = connect(port);
        let dripped = (0..1000).take_while(|_| {
            std::thread::sleep(Duration::from_millis(20));
            slow.write_all(b"G").is_ok()
        });
        assert!(dripped.count() < 1000, "it is cut off while it still sends");
        assert!(begun.elapsed() >= QUICK.time);
        let mut deaf = connect(port);
        deaf.write_all(GET.as_bytes()).unwrap();
        std::thread::sleep(2 * QUICK.time);
        let mut taken = Vec::new();
        let _ = deaf.read_to_end(&mut taken); // ends, with or without an error
        assert!(taken.len() < 50_000_000, "{} bytes", taken.len());
    }

    #[test]
    fn still_connections_give_way_to_new_ones_and_busy_ones_do_not() {
        let limits = Limits { time: Duration::from_secs(60), patience: Duration::from_millis(1500), ..QUICK };
        let port = serving(5, 10, limits);
        let still: Vec<TcpStream> = (0..3).map(|_| connect(port)).collect();
        std::thread::sleep(Duration::from_millis(30));
        assert_eq!(asked(port, GET), "", "there are three, and they came just now");
        std::thread::sleep(limits.patience + QUICK.patience);
        assert!(asked(port, GET).starts_with("HTTP/1.1 200"));
        drop(still);
    }
}
