//! The viewer in a real browser (Debian's chromium, driven by puppeteer-core), and its server.

use super::end_to_end::finished_run;
use super::support::{expect_code, folder, sample, text};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Whether there is a viewer and a browser to look at it; said loudly where not, a failure in CI
/// with Node.js.
pub fn can_look() -> bool {
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
pub fn chromium() -> PathBuf {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders).map(|f| f.join("chromium")).find(|p| p.is_file());
    found.unwrap_or_else(|| "chromium".into())
}

/// What a person in front of the browser finds; the canvas of the camera lies in `folder/view.png`
/// afterwards.
fn look(address: &str, folder: &Path, what: &str) -> serde_json::Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer/test.mjs");
    let browser = chromium();
    let arguments = [text(&script), text(&browser), address, text(folder), what];
    let output = Command::new("node").args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let problem = String::from_utf8_lossy(&output.stderr).into_owned();
    let seen: serde_json::Value = serde_json::from_str(&said).unwrap_or_else(|_| panic!("{said}{problem}"));
    assert_eq!(seen["errors"], serde_json::json!([]), "{address}: {seen}");
    seen
}

/// Everything that the viewer promises, in the browser; from the first held-out camera it shows
/// what we render.
fn does_all_that_is_promised(address: &str, folder: &Path) -> serde_json::Value {
    std::fs::create_dir_all(folder).unwrap();
    let seen = look(address, folder, "0");
    let promised = "orbit pan zoom fly jump photo splat points cameras depth background exposure turn \
        screenshot crop handle";
    for what in promised.split(' ') {
        assert_eq!(seen[what], true, "{what} does not work: {address}: {seen}");
    }
    let canvas = image::open(folder.join("view.png")).unwrap().to_rgb8();
    let renders = finished_run().join("eval/renders");
    let mut names: Vec<PathBuf> = std::fs::read_dir(renders).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    let render = image::open(&names[0]).unwrap().to_rgb8();
    let psnr = scene::metrics::psnr(&canvas, &render, None).unwrap();
    assert!(psnr >= 28.0, "{address}: {psnr:.2} dB between the browser and our render");
    eprintln!("{address}: {psnr:.2} dB, loaded in {} ms", seen["loadMs"]);
    seen
}

struct Serving(Child, u16);

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn serve(run: &Path) -> Serving {
    serve_with(run, |_| {})
}

fn serve_with(run: &Path, change: impl FnOnce(&mut Command)) -> Serving {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sat-recon"));
    command.args(["view", text(run)]).stderr(Stdio::piped());
    change(&mut command);
    let mut child = command.spawn().unwrap();
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
fn a_page_from_disk_and_a_served_one_do_all_they_promise_and_show_what_we_render() {
    if !can_look() {
        return;
    }
    let dir = folder("viewer");
    let page = dir.join("view.html");
    expect_code(&["export", text(finished_run()), "-o", text(&page)], 0);
    let from_disk = does_all_that_is_promised(&format!("file://{}", page.display()), &dir.join("disk"));
    let serving = serve(finished_run());
    let served = does_all_that_is_promised(&format!("http://127.0.0.1:{}/", serving.1), &dir.join("served"));
    // What the page from disk says to type makes what the served one saves.
    let command = from_disk["command"].as_str().unwrap();
    let crop = command.split("--crop ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let cut = dir.join("cut.ply");
    expect_code(&["export", text(finished_run()), "--crop", crop, "-o", text(&cut)], 0);
    let left = scene::io::read_splat(&cut).unwrap().len();
    let all = scene::io::read_splat(&finished_run().join("splat.ply")).unwrap().len();
    assert!(0 < left && left < all, "{left} of {all}");
    let saved = served["left"].as_f64().unwrap() / left as f64;
    assert!((0.8..1.25).contains(&saved), "both handles moved alike: {saved}");
    std::fs::remove_dir_all(dir).unwrap();
}

/// A run folder with this many Gaussians and a few cameras around them.
fn large_run(folder: &Path, gaussians: usize) {
    let mut g = scene::Gaussians { sh_degree: 3, ..Default::default() };
    let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    for i in 0..gaussians {
        let (z, a) = (1.0 - 2.0 * (i as f32 + 0.5) / gaussians as f32, i as f32 * golden);
        let r = (1.0 - z * z).sqrt();
        g.means.push(glam::Vec3::new(r * a.cos(), r * a.sin(), z));
        g.log_scales.push(glam::Vec3::splat(-5.5));
        g.rotations.push(glam::Quat::IDENTITY);
        g.opacity_logits.push(2.0);
        g.sh.extend((0..48).map(|k| if k < 3 { z * (k as f32 - 1.0) } else { 0.01 * (k as f32 * a).sin() }));
    }
    std::fs::create_dir_all(folder.join("undistorted/sparse/0")).unwrap();
    scene::io::write_splat(&folder.join("splat.ply"), &g).unwrap();
    let options = scene::synthetic::SyntheticOptions { num_points: 50, num_cameras: 4, ..Default::default() };
    let model = scene::synthetic::synthetic_scene(&options, 1).truth;
    scene::io::write_model_bin(&model, &folder.join("undistorted/sparse/0")).unwrap();
}

#[test]
fn two_hundred_thousand_gaussians_load_from_disk_and_from_the_server() {
    if !can_look() {
        return;
    }
    let dir = folder("viewer_large");
    large_run(&dir, 200_000);
    let page = dir.join("view.html");
    expect_code(&["export", text(&dir), "--html"], 0);
    let size = std::fs::metadata(&page).unwrap().len() >> 20;
    let from_disk = look(&format!("file://{}", page.display()), &dir, "load");
    let serving = serve(&dir);
    let served = look(&format!("http://127.0.0.1:{}/", serving.1), &dir, "load");
    eprintln!("{size} MiB from disk: {} ms; served: {} ms", from_disk["loadMs"], served["loadMs"]);
    for seen in [from_disk, served] {
        // How long it took is a benchmark (docs/benchmarks.md): other tests run beside this one.
        assert!(seen["loadMs"].as_f64().is_some_and(|ms| ms > 0.0), "it did not load: {seen}");
    }
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn the_server_answers_nothing_outside_its_folder_and_no_other_site() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let serving = serve(finished_run());
    let own = format!("127.0.0.1:{}", serving.1);
    assert!(ask(serving.1, &own, "/").starts_with("HTTP/1.1 200"));
    for path in [
        "/../run.json",
        "/run.json",
        "/%2e%2e/run.json",
        "/photo/../../run.json",
        "/etc/passwd",
        "//etc/passwd",
        "/photo/999",
        "/photo/..%2f..%2frun.json",
        "/photo/%2e%2e%2frun.json",
        "/photo/0%00.png",
        "/photo/+1",
        "/..%5c..%5crun.json",
        "/splat.ply",
        "/splat.spz/../run.json",
        "/.stages/args.json",
        "/frame/0",
        "/matte/../../run.json",
        "/cut.glb",
        "http://127.0.0.1/run.json",
    ] {
        assert!(ask(serving.1, &own, path).starts_with("HTTP/1.1 404"), "{path}");
    }
    assert!(ask(serving.1, "evil.example", "/").starts_with("HTTP/1.1 403"));
    for odd in ["/cut.ply?box=1,2,3", "/cut.spz?floaters=x", "/cut.ply?../run.json=1"] {
        assert!(ask(serving.1, &own, odd).starts_with("HTTP/1.1 400"), "{odd}");
    }
    let report = ask(serving.1, &own, "/report.html");
    assert!(
        report.starts_with("HTTP/1.1 200") && report.contains("default-src 'none'"),
        "the report fetches nothing"
    );
}

/// Image and folder names that would be code, if any of them were taken for HTML.
const HOSTILE: [&str; 4] = [
    "\"><img src=x onerror=\"window.hacked=1\">.png",
    "<script>window.hacked=1</script>.png",
    "'-(window.hacked=1)-'.png",
    "</script><svg onload=window.hacked=1>.png",
];

#[test]
fn names_from_files_are_text_in_every_page_and_the_served_one_forbids_code_in_it() {
    if !can_look() {
        return;
    }
    let dir = folder("viewer_hostile");
    let run = dir.join("<img src=x onerror=window.hacked=1>");
    large_run(&run, 50);
    let model = run.join("undistorted/sparse/0");
    let mut named = scene::io::read_model(&model).unwrap();
    for (image, name) in named.images.values_mut().zip(HOSTILE) {
        image.name = name.replace('/', "⁄");
    }
    scene::io::write_model_bin(&named, &model).unwrap();
    let page = dir.join("view.html");
    expect_code(&["export", text(&run), "-o", text(&page)], 0);
    let serving = serve(&run);
    let address = format!("http://127.0.0.1:{}/", serving.1);
    for address in [format!("file://{}", page.display()), address] {
        assert_eq!(look(&address, &dir, "load")["foreign"], 0, "{address}");
    }
    let served = ask(serving.1, &format!("127.0.0.1:{}", serving.1), "/");
    let (head, body) = served.split_once("\r\n\r\n").unwrap();
    assert!(head.contains("Content-Security-Policy: default-src 'none'; script-src 'self'"), "{head}");
    // Data, and the script by its address.
    let scripts = body.split("<script").skip(1).map(|s| s.split('>').next().unwrap_or_default());
    assert!(scripts.clone().all(|s| s.contains("type=\"") || s.contains("src=\"viewer.js\"")), "{body}");
    std::fs::remove_dir_all(dir).unwrap();
}

/// The start of the answer to a request that is sent as it is.
fn raw(port: u16, request: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let _ = stream.write_all(request.as_bytes()); // it may be cut off
    let mut start = [0; 1024];
    let read = stream.read(&mut start).unwrap_or(0);
    String::from_utf8_lossy(&start[..read]).into_owned()
}

#[test]
fn a_client_that_never_reads_keeps_nobody_waiting_and_odd_requests_are_answered_rightly() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let dir = folder("viewer_stalled");
    large_run(&dir, 100_000);
    let serving = serve(&dir);
    let host = format!("Host: 127.0.0.1:{}\r\nConnection: close\r\n", serving.1);
    let stalled: Vec<TcpStream> = (0..8)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", serving.1)).unwrap();
            stream.write_all(format!("GET /splat.spz HTTP/1.1\r\n{host}\r\n").as_bytes()).unwrap();
            stream
        })
        .collect();
    let asks = |method: &str, path: &str, more: &str| {
        raw(serving.1, &format!("{method} {path} HTTP/1.1\r\n{host}{more}\r\n"))
    };
    let page = asks("GET", "/", "");
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("nosniff"), "{page}");
    let head = asks("HEAD", "/", "");
    assert!(head.starts_with("HTTP/1.1 200") && head.trim_end().lines().all(|l| !l.contains('<')), "{head}");
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        let said = asks(method, "/", "Content-Length: 0\r\n");
        assert!(said.starts_with("HTTP/1.1 405") && said.contains("Allow: GET, HEAD"), "{method}: {said}");
    }
    let other_site = "Sec-Fetch-Site: cross-site\r\n";
    assert!(asks("GET", "/splat.spz", other_site).starts_with("HTTP/1.1 403"));
    assert!(asks("GET", "/", other_site).starts_with("HTTP/1.1 200"), "a link to the page");
    for odd in ["\r\n\r\n", "GET\r\n\r\n", "GET / HTTP/9.9\r\n\r\n", "\u{0}\u{1}\u{2}\r\n\r\n"] {
        let said = raw(serving.1, odd);
        assert!(!said.starts_with("HTTP/1.1 200"), "{odd:?}: {said}");
    }
    assert!(asks("GET", "/", "").starts_with("HTTP/1.1 200"), "it still answers");
    drop(stalled);
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn clients_that_say_nothing_or_drip_are_cut_off_and_keep_no_other_waiting() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let dir = folder("viewer_slow");
    large_run(&dir, 50);
    let serving = serve(&dir);
    let host = format!("127.0.0.1:{}", serving.1);
    let silent: Vec<TcpStream> =
        (0..100).filter_map(|_| TcpStream::connect(("127.0.0.1", serving.1)).ok()).collect();
    std::thread::sleep(Duration::from_millis(1500));
    let request = format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n");
    // Where all are busy a client is refused, for a second at most.
    let is_answered = || {
        (0..100).any(|_| {
            let answered = raw(serving.1, &request).starts_with("HTTP/1.1 200");
            if !answered {
                std::thread::sleep(Duration::from_millis(50));
            }
            answered
        })
    };
    assert!((0..20).all(|_| is_answered()), "{} silent clients", silent.len());
    let begun = Instant::now();
    let mut drips = TcpStream::connect(("127.0.0.1", serving.1)).unwrap();
    let sent = (0..300).take_while(|_| {
        std::thread::sleep(Duration::from_millis(100));
        drips.write_all(b"G").is_ok()
    });
    let sent = sent.count();
    assert!(sent < 300 && begun.elapsed() > Duration::from_secs(5), "cut off after {sent} bytes");
    let long = format!("GET /{} HTTP/1.1\r\nHost: {host}\r\n\r\n", "a".repeat(40_000));
    assert!(raw(serving.1, &long).starts_with("HTTP/1.1 431"));
    assert!(is_answered(), "it still answers");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_link_that_leads_out_of_the_folder_is_not_followed() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let dir = folder("viewer_links");
    let (run, secret) = (dir.join("run"), dir.join("secret.txt"));
    large_run(&run, 10);
    std::fs::write(&secret, "secret").unwrap();
    let images = run.join("undistorted/images");
    std::fs::create_dir_all(&images).unwrap();
    let model = scene::io::read_model(&run.join("undistorted/sparse/0")).unwrap();
    let names: Vec<&str> = model.images.values().map(|i| i.name.as_str()).collect();
    std::fs::write(images.join(names[0]), "photo").unwrap();
    std::os::unix::fs::symlink(&secret, images.join(names[1])).unwrap();
    let serving = serve(&run);
    let own = format!("127.0.0.1:{}", serving.1);
    assert!(ask(serving.1, &own, "/photo/0").contains("photo"));
    let said = ask(serving.1, &own, "/photo/1");
    assert!(said.starts_with("HTTP/1.1 404") && !said.contains("secret"), "{said}");
    std::fs::remove_dir_all(dir).unwrap();
}

/// Nobody needs Node.js to look at results: the bundle comes with the sources, and is of them.
#[test]
fn the_viewer_is_there_without_node_and_is_the_one_of_the_sources() {
    let viewer = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer");
    let check = ["--check", "--quiet", "viewer.sums"];
    let sums = Command::new("sha256sum").args(check).current_dir(&viewer).output().unwrap();
    assert!(sums.status.success(), "run 'make viewer': {}", String::from_utf8_lossy(&sums.stdout));
    let dir = folder("viewer_without_node");
    large_run(&dir, 10);
    let serving = serve_with(&dir, |command| {
        command.env("PATH", "/nowhere");
    });
    let script = ask(serving.1, &format!("127.0.0.1:{}", serving.1), "/viewer.js");
    assert!(script.starts_with("HTTP/1.1 200") && script.len() > 1_000_000, "{} bytes", script.len());
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_folder_without_a_splat_is_refused_by_name() {
    let dir = folder("nosplat");
    let said = expect_code(&["view", text(&dir)], 1);
    assert!(said.contains("splat.ply"), "{said}");
    std::fs::remove_dir_all(dir).unwrap();
}

/// A run that is looked at: the process, and the address that it gave to the browser.
fn run_with_page(dir: &Path, input: &Path, flags: &str) -> (Child, String) {
    use std::os::unix::fs::PermissionsExt as _;
    let (opener, told) = (dir.join("browser.sh"), dir.join("address"));
    let script = format!("#!/bin/sh\nprintf %s \"$1\" > {0}.new && mv {0}.new {0}\n", text(&told));
    std::fs::write(&opener, script).unwrap();
    std::fs::set_permissions(&opener, std::fs::Permissions::from_mode(0o755)).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_sat-recon"))
        .args([text(input), "-o", text(&dir.join("out")), "--view"])
        .args(flags.split(' '))
        .env("BROWSER", &opener)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    for _ in 0..600 {
        if let Ok(address) = std::fs::read_to_string(&told) {
            return (child, address);
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let _ = child.kill();
    panic!("no browser was opened: {:?}", child.wait());
}

#[test]
fn a_run_is_looked_at_while_it_works_frames_mattes_poses_and_the_splat_as_it_is_trained() {
    if !can_look() {
        return;
    }
    let dir = folder("viewer_live");
    let flags = "--frames 30 --max-size 320 --quality draft --iterations 6000 --max-gaussians 8000";
    let (mut child, address) = run_with_page(&dir, &sample("testbed/case3/video.mp4"), flags);
    assert!(address.starts_with("http://127.0.0.1:"), "{address}");
    let pictures = std::env::var_os("SAT_RECON_PICTURES").map_or_else(|| dir.join("pictures"), PathBuf::from);
    std::fs::create_dir_all(&pictures).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer/test_live.mjs");
    let output =
        Command::new("node").args([text(&script), text(&chromium()), &address, text(&pictures)]).output();
    let output = output.unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let problem = String::from_utf8_lossy(&output.stderr).into_owned();
    let seen: serde_json::Value = serde_json::from_str(&said).unwrap_or_else(|_| panic!("{said}{problem}"));
    let number = |what: &str| seen[what].as_f64().unwrap();
    assert_eq!(seen["errors"], serde_json::json!([]), "{seen}");
    assert!(seen["stages"].as_array().unwrap().len() >= 3, "stages go by: {seen}");
    assert!(number("frames") >= 3.0 && number("mattes") >= 3.0, "frames and mattes are there: {seen}");
    assert!(number("camerasBeforeSplat") >= 15.0 && number("posed") >= 3.0, "poses before the splat: {seen}");
    assert!(number("splatsWhileTraining") >= 1.0, "the splat while it is trained: {seen}");
    assert!(number("splats") > number("splatsWhileTraining"), "and the last one: {seen}");
    assert_eq!((&seen["ended"], &seen["report"]), (&true.into(), &200.into()), "{seen}");
    assert!(!seen["verdict"].as_str().unwrap().is_empty(), "{seen}");
    // It stays until the page is closed, or Ctrl-C.
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let code = child.wait().unwrap().code();
    assert!(matches!(code, Some(0 | 3)), "{code:?}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn without_a_page_that_looks_on_a_run_with_view_ends_by_itself_and_says_where_the_page_was() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let dir = folder("viewer_unseen");
    let out = dir.join("out");
    let output = Command::new(env!("CARGO_BIN_EXE_sat-recon"))
        .args(["frames", text(&sample("sample/orbit.mp4")), "-o", text(&out), "--frames", "4", "--view"])
        .env_remove("BROWSER")
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("to watch, open http://127.0.0.1:"), "{said}");
    let kept = std::fs::read_to_string(out.join(".stages/args.json")).unwrap();
    assert!(!kept.contains("--view"), "the next run is not watched because this one was: {kept}");
    std::fs::remove_dir_all(dir).unwrap();
}
