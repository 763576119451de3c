//! Compiles the C++ side of the bundle adjustment and links Ceres.

use std::path::PathBuf;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=src/ceres");
    let mut build = cxx_build::bridge("src/ceres/mod.rs");
    build.file("src/ceres/solver.cc").include("src/ceres").std("c++17").opt_level(2).define("NDEBUG", None);
    for directory in eigen_includes() {
        build.flag("-isystem").flag(directory.to_string_lossy().as_ref());
    }
    build.flag_if_supported("-Wno-unused-parameter").compile("sat_recon_ceres");
    println!("cargo:rustc-link-lib=ceres");
    println!("cargo:rustc-link-lib=glog");
}

/// Where Eigen's headers lie: pkg-config's answer, else Debian's folder.
fn eigen_includes() -> Vec<PathBuf> {
    let output = Command::new("pkg-config").args(["--cflags-only-I", "eigen3"]).output();
    let flags =
        output.ok().filter(|o| o.status.success()).map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
    let found: Vec<PathBuf> = flags
        .iter()
        .flat_map(|f| f.split_whitespace())
        .filter_map(|f| f.strip_prefix("-I"))
        .map(PathBuf::from)
        .collect();
    if found.is_empty() { vec![PathBuf::from("/usr/include/eigen3")] } else { found }
}
