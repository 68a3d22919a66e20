//! `deploy/leaderboard/make.sh`, which makes a board from nothing.

use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use fiatlux_tests::programs::{PATIENCE, Scratch, program, wait_until};

/// The script with the programs under test; its stderr goes to the file `said`.
fn make(scratch: &Scratch, http: &str) -> Child {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/leaderboard/make.sh");
    let mut command = Command::new("bash");
    for (name, of) in
        [("FIATLUX", "fiatlux"), ("SIM_SERVER", "sim-server"), ("SCORER", "scorer"), ("POLICY_CLIENT", "policy-client")]
    {
        command.env(name, program(of));
    }
    command.arg(script).args(["--policies", "stand", "--seeds", "0", "--http", http, "--out"]);
    let said = std::fs::File::create(scratch.path().join("said")).unwrap();
    command.arg(scratch.path().join("board")).stdin(Stdio::null()).stdout(Stdio::null()).stderr(said);
    command.spawn().unwrap()
}

fn read(scratch: &Scratch, file: &str) -> String {
    std::fs::read_to_string(scratch.path().join(file)).unwrap_or_default()
}

/// The address after `://` or `tcp/` in a text.
fn address(text: &str) -> Option<String> {
    let rest = text.split_once("127.0.0.1:")?.1;
    Some(format!("127.0.0.1:{}", rest.split(|c: char| !c.is_ascii_digit()).next()?))
}

/// Guards minutes of play that end at a port which was taken from the start.
#[test]
fn a_taken_port_is_said_before_anything_is_played() {
    let scratch = Scratch::new("make-port");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let status = make(&scratch, &taken.local_addr().unwrap().to_string()).wait().unwrap();
    let said = read(&scratch, "said");
    assert_eq!(status.code(), Some(1), "{said}");
    assert!(said.contains("make.sh: the leaderboard did not start") && said.contains("in use"), "{said}");
    assert!(!said.contains("plays") && !scratch.path().join("board/runs").exists(), "{said}");
}

/// Guards servers that go on behind the back of whoever pressed Ctrl-C, or stopped the script alone.
#[test]
fn an_interrupt_ends_it_and_all_that_it_started() {
    let scratch = Scratch::new("make-interrupt");
    let mut script = make(&scratch, "127.0.0.1:0");
    wait_until("a policy plays", PATIENCE, || read(&scratch, "said").contains("== stand plays"));
    let listening = ["board/address", "board/server"].map(|file| address(&read(&scratch, file)).unwrap());
    listening.iter().for_each(|address| drop(TcpStream::connect(address).unwrap()));
    assert!(Command::new("kill").args(["-INT", &script.id().to_string()]).status().unwrap().success());
    let status = script.wait().unwrap();
    let said = read(&scratch, "said");
    assert!(status.code() == Some(130) && said.contains("the same command goes on from here"), "{status}: {said}");
    for address in listening {
        assert!(TcpStream::connect(&address).is_err(), "{address} still answers");
    }
}
