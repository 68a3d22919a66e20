//! The program `recorder`.

fn main() -> std::process::ExitCode {
    sim_server::recorder::run()
}
