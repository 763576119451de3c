//! The Python package runs this program: its own tests, where Python and numpy are installed.

use std::path::Path;
use std::process::Command;

#[test]
fn the_python_package_runs_the_program_and_reads_its_results() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    // Where another Python comes first on the PATH, Debian's has numpy.
    let python = ["python3", "/usr/bin/python3"].into_iter().find(|python| {
        let numpy = Command::new(python).args(["-c", "import numpy"]).output();
        numpy.is_ok_and(|o| o.status.success())
    });
    let Some(python) = python else {
        assert!(std::env::var_os("CI").is_none(), "python3 or numpy is missing");
        return eprintln!("SKIPPED: the Python package's tests need python3 with numpy");
    };
    let run = Command::new(python)
        .args(["-B", "-m", "unittest", "-v", "test_sat_recon"])
        .current_dir(root.join("python/tests"))
        .env("SAT_RECON", env!("CARGO_BIN_EXE_sat-recon"))
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}
