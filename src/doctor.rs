//! What is installed, which adapters there are, and what will be slow.

use crate::outcome::Outcome;
use crate::terminal::print;
use anyhow::Result;

/// Libraries and programs in use, with their versions; missing ones say so.
pub fn library_versions() -> Vec<(String, String)> {
    let found = preprocess::versions().into_iter();
    found.map(|(name, version)| (name, version.unwrap_or_else(|why| format!("missing ({why})")))).collect()
}

/// Prints what was found, a line each, and what follows from it.
pub fn run(json: bool) -> Result<Outcome> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut rows = vec![
        ("sat-recon".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("processor".to_owned(), format!("{cores} core(s), {}", instruction_set())),
    ];
    rows.push(("memory".to_owned(), memory().unwrap_or_else(|| "unknown".into())));
    rows.extend(library_versions());
    let adapters = splat::adapters();
    rows.push(graphics(&adapters));
    rows.push(("COLMAP (for compare --colmap)".to_owned(), program_version("colmap")));
    if json {
        print(&serde_json::to_string_pretty(&rows)?)?;
    } else {
        for (name, value) in &rows {
            print(&format!("{name:<32} {value}"))?;
        }
        for line in advice(cores, &rows, &adapters) {
            print(&format!("note: {line}"))?;
        }
    }
    Ok(Outcome::Done)
}

fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            return "AVX-512";
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return "AVX2 and FMA";
        }
        "x86-64 without AVX2"
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH
    }
}

fn memory() -> Option<String> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let (all, free) = (gib(&info, "MemTotal:")?, gib(&info, "MemAvailable:")?);
    Some(format!("{all:.1} GiB, {free:.1} GiB free"))
}

/// A line of `/proc/meminfo`, which is in KiB.
fn gib(info: &str, key: &str) -> Option<f64> {
    let kib: f64 = info.lines().find(|l| l.starts_with(key))?.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / f64::from(1 << 20))
}

/// The graphics adapters by name and kind; where none can be opened, the installed drivers.
fn graphics(adapters: &[splat::Adapter]) -> (String, String) {
    if adapters.is_empty() {
        return ("Vulkan drivers".to_owned(), vulkan_drivers());
    }
    let names: Vec<String> = adapters.iter().map(ToString::to_string).collect();
    ("graphics adapters".to_owned(), names.join("; "))
}

/// The installed Vulkan drivers (the loader's manifests).
fn vulkan_drivers() -> String {
    let folders = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];
    let mut names: Vec<String> = folders
        .iter()
        .filter_map(|folder| std::fs::read_dir(folder).ok())
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path().file_stem()?.to_string_lossy().into_owned()))
        .filter(|name| name.contains("icd"))
        .collect();
    names.sort();
    names.dedup();
    if names.is_empty() {
        "none (not needed: training and rendering run on the CPU)".into()
    } else {
        format!("{}, but none of them finds an adapter", names.join(", "))
    }
}

fn program_version(program: &str) -> String {
    match std::process::Command::new(program).arg("help").env("QT_QPA_PLATFORM", "offscreen").output() {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            text.lines().next().unwrap_or("present").to_owned()
        }
        Err(_) => "not installed".into(),
    }
}

fn advice(cores: usize, rows: &[(String, String)], adapters: &[splat::Adapter]) -> Vec<String> {
    let mut lines = Vec::new();
    if cores < 2 {
        lines.push("one core: matching and training take twice as long as on two".into());
    }
    if instruction_set() == "x86-64 without AVX2" {
        lines.push("no AVX2: training and matching run several times slower".into());
    }
    match adapters.iter().find(|a| a.kind.is_hardware()) {
        Some(adapter) => lines.push(format!("the splat is trained and rendered on {}", adapter.name)),
        None => lines.push("no graphics card: the splat is trained and rendered on the CPU".into()),
    }
    for (name, value) in rows {
        if value.starts_with("missing") {
            lines.push(format!("{name} is missing: 'make setup' installs it"));
        }
    }
    lines
}
