//! Makes components from core modules: `encode MODULE COMPONENT [MODULE COMPONENT ...]`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    for pair in files.chunks_exact(2) {
        let component = holdpoint_builder::encode(std::fs::read(&pair[0])?)?;
        std::fs::write(&pair[1], component)?;
    }
    Ok(())
}
