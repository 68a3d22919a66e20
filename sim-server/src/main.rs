//! The program `sim-server`.

fn main() -> std::process::ExitCode {
    sim_server::run()
}
