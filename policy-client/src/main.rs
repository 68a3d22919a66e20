//! The program `policy-client`.

fn main() -> std::process::ExitCode {
    policy_client::run()
}
