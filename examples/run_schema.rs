//! Prints the JSON schema of `run.json`: `cargo run --example run_schema > docs/run.schema.json`.

fn main() -> serde_json::Result<()> {
    println!("{}", serde_json::to_string_pretty(&sat_recon::record::run_schema())?);
    Ok(())
}
