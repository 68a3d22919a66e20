//! The program `scorer`.

fn main() -> std::process::ExitCode {
    scorer::run()
}
