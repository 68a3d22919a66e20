//! The client in Python that is written from the protocol's page alone (`docs/client.py`), against a real server.
//! `FIATLUX_PYTHON` names a Python with the packages of `docs/client.requirements.txt`; `tests/run` makes one.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use fiatlux_tests::programs::{Service, endpoint};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

fn output(command: &mut Command) -> Output {
    command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"))
}

fn succeed(command: &mut Command) -> String {
    let output = output(command);
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The Python, and a folder with the messages as modules.
fn python() -> (PathBuf, PathBuf) {
    let python =
        PathBuf::from(std::env::var_os("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one"));
    let modules = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-client");
    std::fs::create_dir_all(&modules).unwrap();
    let messages = ["session", "observation", "room"].map(|name| format!("fiatlux/v3/{name}.proto"));
    let mut protoc = Command::new(&python);
    protoc.args(["-m", "grpc_tools.protoc", "-I", "proto/proto", "--python_out"]).arg(&modules).args(messages);
    succeed(protoc.current_dir(ROOT));
    (python, modules)
}

/// The client of the page is short enough to be read.
#[test]
fn the_client_of_the_page_is_short() {
    let text = std::fs::read_to_string(Path::new(ROOT).join("docs/client.py")).unwrap();
    assert!(text.lines().count() < 120);
}

/// Guards that the page says all that a client in another language needs: its episode is that of our own client. It takes no
/// other server's answer.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn a_client_from_the_page_alone() {
    let (python, modules) = python();
    let service = Service::start("python", &[]);
    let expected = service.play(&["--policy", "zero", "--task", "S07"]).remove(0);
    let client = |key: &str| {
        let mut client = Command::new(&python);
        client.arg("docs/client.py").args([&endpoint(service.port), "test", "S07", key]);
        client.env("PYTHONPATH", &modules).current_dir(ROOT);
        client
    };
    let log = service.server.log();
    let key =
        log.split("key=").nth(1).and_then(|rest| rest.split_whitespace().next()).unwrap_or_else(|| panic!("{log}"));
    let said = succeed(&mut client(key));
    let (cause, steps, digest) = (expected.cause, expected.steps, expected.digest);
    assert_eq!(said.trim(), format!("{cause} after {steps} steps, digest {digest}"));
    let other = fiatlux_access::Identity::generate().unwrap().public().to_string();
    let refused = output(&mut client(&other));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && said.contains("no server 'test' with that key answers"), "{said}");
}
