//! What comes from outside the program: closed pipes, full devices, odd arguments, files that lead
//! elsewhere or ask for too much. Refused by name, exit code 1, and never a crash.

use super::end_to_end::finished_run;
use super::support::{expect_code, folder, sample, sat_recon_in, text};
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Stdio};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_sat-recon"))
}

#[test]
fn a_reader_that_has_gone_away_is_no_error_and_a_full_device_is_one() {
    for arguments in [&["--help"][..], &["doctor"], &["doctor", "--json"], &["compare", text(finished_run())]]
    {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let run = program().args(arguments).stdout(writer).output().unwrap();
        assert_eq!(run.status.code(), Some(0), "{arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
        let full = || File::options().write(true).open("/dev/full").unwrap();
        let run = program().args(arguments).stdout(full()).output().unwrap();
        assert_eq!(run.status.code(), Some(1), "{arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
        let run = program().args(arguments).stderr(full()).stdout(Stdio::null()).status().unwrap();
        assert_eq!(run.code(), Some(0), "{arguments:?}");
    }
    let full = File::options().write(true).open("/dev/full").unwrap();
    assert_eq!(program().arg("no/such.mp4").stderr(full).status().unwrap().code(), Some(1));
}

#[test]
fn arguments_that_are_not_text_are_refused() {
    let odd = std::ffi::OsStr::from_bytes(b"video\xff.mp4");
    let run = program().arg(odd).output().unwrap();
    assert_eq!(run.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&run.stderr).contains("not UTF-8"));
}

#[test]
fn numbers_beyond_their_limits_are_refused_before_anything_is_done() {
    let input = sample("sample/orbit.mp4");
    for flag in [
        "--octaves=18446744073709551615",
        "--max-reprojection-px=-1",
        "--pre-blur=inf",
        "--learning-rate=nan",
        "--threads=100000",
        "--time-limit=1e308h",
    ] {
        let said = expect_code(&["frames", text(&input), "-o", "never-made", flag], 1);
        let name = flag.split('=').next().unwrap();
        assert!(said.contains(name), "{flag}: {said}");
    }
    assert!(!Path::new("never-made").exists());
}

#[test]
fn a_playlist_that_is_named_like_a_video_opens_nothing() {
    let dir = folder("playlist");
    let secret = dir.join("secret.ts");
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=160x120:rate=5:duration=2", text(&secret)])
        .status()
        .unwrap();
    assert!(made.success());
    let lists = [
        format!(
            "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\nfile://{}\n#EXT-X-ENDLIST\n",
            secret.display()
        ),
        format!("ffconcat version 1.0\nfile '{}'\n", secret.display()),
    ];
    fs::create_dir_all(dir.join("in")).unwrap();
    for list in lists {
        let video = dir.join("in/video.mp4");
        fs::write(&video, list).unwrap();
        let said = expect_code(&["frames", text(&video), "-o", text(&dir.join("out"))], 1);
        assert!(said.contains("video.mp4"), "{said}");
        assert!(!dir.join("out/images").exists(), "{said}");
    }
    expect_code(&["frames", text(&secret), "-o", text(&dir.join("out"))], 0);
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn masks_that_are_links_out_of_the_data_set_are_refused() {
    let dir = folder("linked_masks");
    let (photos, elsewhere) = (dir.join("set/images"), dir.join("elsewhere"));
    for (folder, name, value) in [(&photos, "a.png", 90), (&photos, "b.png", 80), (&elsewhere, "a.png", 255)]
    {
        fs::create_dir_all(folder).unwrap();
        image::RgbImage::from_pixel(64, 48, image::Rgb([value; 3])).save(folder.join(name)).unwrap();
    }
    let (masks, out) = (dir.join("set/masks"), dir.join("out"));
    std::os::unix::fs::symlink(&elsewhere, &masks).unwrap();
    let run = |more: &[&str], code| {
        expect_code(&[&["frames", text(&dir.join("set")), "-o", text(&out)], more].concat(), code)
    };
    assert!(run(&[], 1).contains("link out of its folder"));
    run(&["--masks", text(&elsewhere)], 0);
    fs::remove_file(&masks).unwrap();
    fs::create_dir_all(&masks).unwrap();
    std::os::unix::fs::symlink(elsewhere.join("a.png"), masks.join("a.png")).unwrap();
    assert!(run(&[], 1).contains("link out of its folder"));
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_page_is_not_written_over_the_files_of_others() {
    let dir = folder("foreign_page");
    let run = text(finished_run());
    for (name, word) in [("notes.txt", ".html"), ("mine.html", "no page of sat-recon's")] {
        let path = dir.join(name);
        fs::write(&path, "mine").unwrap();
        let said = expect_code(&["compare", run, "--report", text(&path)], 1);
        assert!(said.contains(word), "{said}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
    }
    let page = dir.join("page.html");
    for _ in 0..2 {
        expect_code(&["compare", run, "--report", text(&page)], 0);
    }
    fs::remove_dir_all(dir).unwrap();
}

/// An `.spz` of version 2 that holds `n` Gaussians of zeros: nothing packs smaller.
fn spz_of_zeros(path: &Path, n: u32) {
    let mut gz = flate2::write::GzEncoder::new(File::create(path).unwrap(), flate2::Compression::best());
    let header = [&0x5053_474e_u32.to_le_bytes()[..], &2_u32.to_le_bytes(), &n.to_le_bytes(), &[0, 12, 0, 0]];
    gz.write_all(&header.concat()).unwrap();
    let zeros = vec![0; 19 << 10];
    (0..n.div_ceil(1 << 10)).for_each(|_| gz.write_all(&zeros).unwrap());
    gz.finish().unwrap();
}

#[test]
fn splats_that_hold_nothing_or_unpack_to_far_more_than_they_are_are_refused() {
    let dir = folder("bombs");
    let (spz, splat, out) = (dir.join("a.spz"), dir.join("a.splat"), dir.join("out.ply"));
    spz_of_zeros(&spz, 1 << 10);
    expect_code(&["export", text(&spz), "-o", text(&out)], 0);
    fs::remove_file(&out).unwrap();
    spz_of_zeros(&spz, 1 << 22);
    fs::write(&splat, "").unwrap();
    for (path, word) in [(&spz, "far more gaussians"), (&splat, "no gaussians")] {
        let said = expect_code(&["export", text(path), "-o", text(&out)], 1);
        assert!(said.contains(word), "{said}");
        assert!(!out.exists());
    }
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn two_videos_of_one_name_do_not_share_a_folder_and_two_runs_do_not_either() {
    let dir = folder("one_name");
    for name in ["a", "b"] {
        fs::create_dir_all(dir.join(name)).unwrap();
        fs::copy(sample("sample/orbit.mp4"), dir.join(name).join("video.mp4")).unwrap();
    }
    let run = |input: &str| sat_recon_in(&dir, &["frames", input, "--frames", "3"].map(str::to_owned));
    assert_eq!(run("a/video.mp4").status.code(), Some(0));
    assert_eq!(run("b/video.mp4").status.code(), Some(0));
    assert!(dir.join("video_recon/images").is_dir() && dir.join("b_video_recon/images").is_dir());
    let again = run("a/video.mp4");
    assert!(String::from_utf8_lossy(&again.stderr).contains("as before"));
    let lock = File::open(dir.join("video_recon/.stages/lock")).unwrap();
    lock.lock().unwrap();
    let refused = run("a/video.mp4");
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(1) && said.contains("another sat-recon"), "{said}");
    drop(lock);
    assert_eq!(run("a/video.mp4").status.code(), Some(0));
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn after_no_model_nothing_of_an_earlier_one_stays_or_is_named() {
    let dir = folder("no_model_again");
    let (out, input) = (dir.join("out"), dir.join("photos"));
    fs::create_dir_all(&input).unwrap();
    let tiny = ["--frames", "10", "--max-size", "140", "--iterations", "10", "--max-gaussians", "1000"];
    let video = sample("sample/orbit.mp4");
    // Ten small frames make a doubtful model.
    expect_code(&[&[text(&video), "-o", text(&out)][..], &tiny].concat(), 3);
    assert!(out.join("splat.ply").exists());
    for value in [10, 200] {
        let grey = image::RgbImage::from_pixel(160, 120, image::Rgb([value; 3]));
        grey.save(input.join(format!("{value}.png"))).unwrap();
    }
    let said = expect_code(&[text(&input), "-o", text(&out)], 2);
    for name in
        ["sparse/0", "splat.ply", "view.html", "undistorted", "eval", "transforms.json", "sparse_points.ply"]
    {
        assert!(!out.join(name).exists(), "{name} stays");
    }
    assert!(said.contains("red: ") && said.contains("report.html") && !said.contains("splat"), "{said}");
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_training_without_masks_is_not_shown_those_of_an_earlier_one() {
    let dir = folder("stale_masks");
    let (set, out) = (dir.join("set"), dir.join("out"));
    let frames = folder("stale_masks_frames");
    let video = sample("sample/orbit.mp4");
    // Ten small frames make a doubtful model.
    expect_code(&["sfm", text(&video), "-o", text(&frames), "--frames", "10", "--max-size", "140"], 3);
    fs::create_dir_all(set.join("masks")).unwrap();
    fs::create_dir_all(set.join("sparse")).unwrap();
    fs::rename(frames.join("images"), set.join("images")).unwrap();
    fs::rename(frames.join("sparse/0"), set.join("sparse/0")).unwrap();
    for entry in fs::read_dir(set.join("images")).unwrap() {
        let mask = image::GrayImage::from_fn(140, 105, |x, _| image::Luma([if x < 70 { 255 } else { 0 }]));
        mask.save(set.join("masks").join(entry.unwrap().file_name())).unwrap();
    }
    let train = ["--iterations", "10", "--max-gaussians", "1000"];
    let run = |more: &[&str], code: i32| {
        expect_code(&[&["train", text(&set), "-o", text(&out)][..], &train, more].concat(), code)
    };
    run(&[], 0);
    assert!(out.join("undistorted/masks").is_dir());
    // All of the photos shows how far the poses of small frames are off.
    run(&["--masks", "off", "--key", "off"], 3);
    assert!(!out.join("undistorted/masks").exists() && !out.join("masks").exists());
    fs::remove_dir_all(dir).unwrap();
    fs::remove_dir_all(frames).unwrap();
}

/// Runs the program under limits of the shell; its exit code and what it said.
fn limited(limits: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let run = Command::new("sh")
        .args(["-c", &format!("{limits} && exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_sat-recon")])
        .args(arguments)
        .output()
        .unwrap();
    (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
}

#[test]
fn without_memory_or_beyond_the_size_of_files_the_program_says_so_and_ends_with_exit_code_1() {
    let dir = folder("limits");
    let (video, out) = (sample("sample/orbit.mp4"), dir.join("out"));
    let frames = ["frames", text(&video), "-o", text(&out), "--frames", "10"];
    let (code, said) = limited("ulimit -f 20", &frames);
    assert!(code == Some(1) && said.contains("error: ") && said.contains("large"), "{code:?} {said}");
    assert!(!out.join("images").exists());
    // Of photos: under such a limit a video's decoder, another process, does not even start.
    let photos = dir.join("frames/images");
    expect_code(&["frames", text(&video), "-o", text(&dir.join("frames")), "--frames", "10"], 0);
    let sfm = ["sfm", text(&photos), "-o", text(&out), "--threads", "1"];
    let (code, said) = limited("ulimit -d 20000", &sfm);
    assert!(code == Some(1) && said.contains("out of memory; lower --max-size"), "{code:?} {said}");
    expect_code(&["clean", text(&out)], 0);
    // ffmpeg inherits the limit: what it says then must not be taken for a damaged video.
    let (code, said) = limited("ulimit -d 40000", &frames[..4]);
    assert!(
        code == Some(1) && said.contains("the limit of 39 MiB of memory may be too low"),
        "{code:?} {said}"
    );
    fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_training_beyond_the_memory_limit_is_refused_before_the_poses_are_sought() {
    let dir = folder("memory_limit");
    let (video, out) = (sample("sample/orbit.mp4"), dir.join("out"));
    let run = [text(&video), "-o", text(&out), "--frames", "10", "--max-size", "140"];
    let said = expect_code(&[&run[..], &["--memory-limit", "200", "--max-gaussians", "1000000"]].concat(), 1);
    assert!(said.contains("training will need about 4") && said.contains("--max-gaussians"), "{said}");
    assert!(!out.join("sparse").exists());
    let small = ["--memory-limit", "200", "--max-gaussians", "1000", "--iterations", "10", "--threads", "1"];
    // Ten small frames make a doubtful model.
    expect_code(&[&run[..], &small].concat(), 3);
    fs::remove_dir_all(dir).unwrap();
}
