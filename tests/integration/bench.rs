//! Quality against time.

use super::end_to_end::finished_run;
use super::support::{expect_code, folder, json, text};

#[test]
fn a_sweep_measures_every_setting_once_and_draws_the_curve() {
    let dir = folder("bench");
    let (input, out) = (finished_run().join("undistorted"), dir.join("out"));
    let peers = dir.join("peers.json");
    let peer = r#"[{"dataset": "x", "source": "somewhere", "points": [{"method": "other", "setting": "s", "cpu_s": 9, "psnr": 20}]}]"#;
    std::fs::write(&peers, peer).unwrap();
    let flags = ["--qualities", "draft", "--times", "2s", "--peers", text(&peers), "-o", text(&out)];
    let after = ["--", "--max-gaussians=8000", "--fps-loops=1"];
    let call = [&["bench", text(&input)][..], &flags, &after].concat();
    let said = expect_code(&call, 0);
    assert_eq!(said.matches("(measured)").count(), 2, "{said}");
    let sweep = json(&out.join("bench.json"));
    let points = sweep["points"].as_array().unwrap();
    assert_eq!(points.len(), 2);
    for point in points {
        assert!(point["psnr"].as_f64().unwrap() > 5.0 && point["cpu_s"].as_f64().unwrap() > 0.0, "{point}");
        assert!(point["gaussians"].as_u64().unwrap() <= 8000, "{point}");
    }
    assert!(points[0]["psnr"].as_f64().unwrap() > 20.0, "{}", points[0]);
    // Without the limit it would be the 15,000 steps of `best`; how many fit into it depends on the
    // machine.
    let wall = points[1]["wall_s"].as_f64().unwrap();
    assert!(wall > 1.0 && wall < 40.0, "{wall} s");
    let svg = std::fs::read_to_string(out.join("bench.svg")).unwrap();
    assert!(svg.contains("draft") && svg.contains("2 s") && svg.contains("other"));
    assert_eq!(expect_code(&call, 0).matches("(as before)").count(), 2);
    assert!(expect_code(&["bench", text(&input), "--only-times"], 1).contains("--times"));
    let nothing = dir.join("nothing");
    let said = expect_code(&["bench", "/no/such/input", "-o", text(&nothing)], 1);
    assert!(said.contains("cannot read /no/such/input") && !nothing.exists(), "{said}");
    std::fs::remove_dir_all(dir).unwrap();
}
