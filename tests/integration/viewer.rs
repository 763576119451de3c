//! The viewer in a real browser (Debian's chromium, driven by puppeteer-core), and its server.

use super::end_to_end::finished_run;
use super::support::{expect_code, folder, text};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Whether there is a viewer and a browser to look at it; said loudly where not, a failure in CI with Node.js.
fn can_look() -> bool {
    let has =
        |program: &str| Command::new(program).arg("--version").output().is_ok_and(|o| o.status.success());
    let modules = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer/node_modules/puppeteer-core");
    let able = sat_recon::view::BUNDLE.is_some() && has("node") && has("chromium") && modules.is_dir();
    assert!(
        able || std::env::var_os("CI").is_none() || !has("node"),
        "CI has Node.js, but no viewer or browser"
    );
    if !able {
        eprintln!("SKIPPED: the viewer's tests need Node.js, npm and chromium (make test installs chromium)");
    }
    able
}

/// Where the browser is: puppeteer wants a path.
fn chromium() -> PathBuf {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders).map(|f| f.join("chromium")).find(|p| p.is_file());
    found.unwrap_or_else(|| "chromium".into())
}

/// Opens an address in the browser, jumps to the first held-out camera and compares the canvas with our render.
fn looks_like_our_render(address: &str, picture: &Path) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer/test.mjs");
    let browser = chromium();
    let arguments = [text(&script), text(&browser), address, text(picture), "0"];
    let output = Command::new("node").args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let problem = String::from_utf8_lossy(&output.stderr).into_owned();
    let seen: serde_json::Value = serde_json::from_str(&said).unwrap_or_else(|_| panic!("{said}{problem}"));
    assert_eq!(seen["errors"], serde_json::json!([]), "{address}");
    assert_eq!(seen["turns"], true, "the view did not turn");
    let canvas = image::open(picture).unwrap().to_rgb8();
    let renders = finished_run().join("eval/renders");
    let mut names: Vec<PathBuf> = std::fs::read_dir(renders).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    let render = image::open(&names[0]).unwrap().to_rgb8();
    let psnr = scene::metrics::psnr(&canvas, &render, None).unwrap();
    assert!(psnr >= 28.0, "{address}: {psnr:.2} dB between the browser and our render");
}

struct Serving(Child, u16);

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn serve() -> Serving {
    let mut child = Command::new(env!("CARGO_BIN_EXE_sat-recon"))
        .args(["view", text(finished_run())])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut line).unwrap();
    let port = line.split("127.0.0.1:").nth(1).and_then(|rest| rest.split(' ').next()?.parse().ok());
    Serving(child, port.unwrap_or_else(|| panic!("no port in: {line}")))
}

fn ask(port: u16, host: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn a_page_from_disk_and_a_served_one_show_what_we_render() {
    if !can_look() {
        return;
    }
    let dir = folder("viewer");
    let page = dir.join("view.html");
    expect_code(&["export", text(finished_run()), "-o", text(&page)], 0);
    looks_like_our_render(&format!("file://{}", page.display()), &dir.join("disk.png"));
    let serving = serve();
    looks_like_our_render(&format!("http://127.0.0.1:{}/", serving.1), &dir.join("served.png"));
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn the_server_answers_nothing_outside_its_folder_and_no_other_site() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let serving = serve();
    let own = format!("127.0.0.1:{}", serving.1);
    assert!(ask(serving.1, &own, "/").starts_with("HTTP/1.1 200"));
    for path in [
        "/../run.json",
        "/run.json",
        "/%2e%2e/run.json",
        "/photo/../../run.json",
        "/etc/passwd",
        "/photo/999",
    ] {
        assert!(ask(serving.1, &own, path).starts_with("HTTP/1.1 404"), "{path}");
    }
    assert!(ask(serving.1, "evil.example", "/").starts_with("HTTP/1.1 403"));
}

#[test]
fn a_folder_without_a_splat_is_refused_by_name() {
    let dir = folder("nosplat");
    let said = expect_code(&["view", text(&dir)], 1);
    assert!(said.contains("splat.ply") || said.contains("Node.js"), "{said}");
    std::fs::remove_dir_all(dir).unwrap();
}
