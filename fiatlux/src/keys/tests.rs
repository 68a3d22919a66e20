//! Files that one call leaves behind, and those that it leaves alone.
#![allow(clippy::unwrap_used)]

use std::os::unix::fs::PermissionsExt as _;

use super::*;

fn options(name: &str, authentication: Authentication) -> KeysOptions {
    let out = std::env::temp_dir().join(format!("fiatlux-keys-test-{name}-{}", std::process::id()));
    drop(fs::remove_dir_all(&out));
    let hosts = vec!["192.168.1.7".into(), "lab.example.org".into()];
    KeysOptions { out, hosts, port: 7447, servers: vec!["lab".into()], authentication, days: 365, sessions: 4 }
}

#[test]
fn one_call_makes_all_files_and_secrets_stay_secret() {
    for (name, authentication) in [("mtls", Authentication::Certificates), ("pwd", Authentication::Passwords)] {
        let options = options(name, authentication);
        let made = make(&options).unwrap();
        let mut names: Vec<_> = made.files.iter().map(|file| file.path.clone()).collect();
        let mut found: Vec<_> = fs::read_dir(&options.out).unwrap().map(|file| file.unwrap().path()).collect();
        names.sort();
        found.sort();
        assert_eq!(names, found);
        for file in &made.files {
            let mode = fs::metadata(&file.path).unwrap().permissions().mode() & 0o777;
            assert_eq!(mode, if file.secret { 0o600 } else { 0o644 }, "{}", file.path.display());
        }
        assert_eq!(fs::metadata(&options.out).unwrap().permissions().mode() & 0o777, 0o700);
        for role in Role::ALL {
            let text = fs::read_to_string(options.out.join(format!("{}.json5", role.name()))).unwrap();
            let config = zenoh::Config::from_json5(&text).unwrap();
            assert_eq!(config.get_json("access_control/default_permission").unwrap(), "\"deny\"");
            let endpoints =
                config.get_json(if role == Role::Router { "listen/endpoints" } else { "connect/endpoints" });
            let protocol = if name == "mtls" { "quic" } else { "tcp" };
            let host = if role == Role::Router { "0.0.0.0" } else { "192.168.1.7" };
            assert_eq!(endpoints.unwrap(), format!("[\"{protocol}/{host}:7447\"]"));
        }
        let identity = Identity::read(&options.out.join("server_identity")).unwrap();
        let known = KnownServers::read(&options.out.join("known_servers")).unwrap();
        assert_eq!(known.key_of("lab"), Some(identity.public()));
        let token = Token::read(&options.out.join("policy_token")).unwrap();
        let tokens = Tokens::read(&options.out.join("server_tokens")).unwrap();
        assert_eq!(tokens.check(&token).map(Grant::limit), Some(4));
        RecorderKey::read(&options.out.join("recorder_key")).unwrap();
        fs::remove_dir_all(&options.out).unwrap();
    }
}

#[test]
fn a_second_call_refuses_and_loses_nothing() {
    let options = options("twice", Authentication::Certificates);
    let made = make(&options).unwrap();
    let read = || made.files.iter().map(|file| fs::read(&file.path).unwrap()).collect::<Vec<_>>();
    let before = read();
    assert!(matches!(make(&options), Err(KeysError::Exists(path)) if path == options.out));
    assert_eq!(read(), before);
    fs::remove_dir_all(&options.out).unwrap();
    fs::write(&options.out, "a file").unwrap();
    assert!(matches!(make(&options), Err(KeysError::Exists(_))));
    fs::remove_file(&options.out).unwrap();
    fs::create_dir(&options.out).unwrap();
    make(&options).expect("an empty folder will do");
    fs::remove_dir_all(&options.out).unwrap();
}

#[test]
fn what_cannot_be_made_leaves_nothing_behind() {
    for (host, server, words) in [
        ("a b", "lab", "--host a b"),
        ("", "lab", "--host"),
        ("lab:7447", "lab", "--host lab:7447"),
        ("lab", "a/b", "--name a/b"),
        ("lab", "lab,lab", "--name lab"),
        ("lab", "lab,l b", "--name l b"),
        ("lab", "lab-*", "--name lab-*"),
        ("lab", "", "--name"),
    ] {
        let options = KeysOptions {
            hosts: vec![host.into()],
            servers: server.split(',').map(str::to_owned).collect(),
            ..options("wrong", Authentication::Passwords)
        };
        let message = make(&options).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
        assert!(!options.out.exists());
    }
}

/// The router listens on the addresses by which programs are told to reach it.
#[test]
fn a_router_listens_where_its_host_is_looked_for() {
    let cases: [(&[&str], &str, &str); 7] = [
        (&[], "[\"tcp/127.0.0.1:7447\"]", "[\"tcp/127.0.0.1:7447\"]"),
        (&["localhost"], "[\"tcp/127.0.0.1:7447\"]", "[\"tcp/localhost:7447\"]"),
        (&["::1"], "[\"tcp/[::1]:7447\"]", "[\"tcp/[::1]:7447\"]"),
        (&["127.0.0.1", "::1"], "[\"tcp/127.0.0.1:7447\",\"tcp/[::1]:7447\"]", "[\"tcp/127.0.0.1:7447\"]"),
        (&["lab"], "[\"tcp/0.0.0.0:7447\"]", "[\"tcp/lab:7447\"]"),
        (&["2001:db8::7"], "[\"tcp/[::]:7447\"]", "[\"tcp/[2001:db8::7]:7447\"]"),
        (&["192.168.1.7", "2001:db8::7"], "[\"tcp/[::]:7447\"]", "[\"tcp/192.168.1.7:7447\"]"),
    ];
    for (hosts, listen, connect) in cases {
        let hosts = hosts.iter().map(ToString::to_string).collect();
        let options = KeysOptions { hosts, ..options("hosts", Authentication::Passwords) };
        for (role, key, expected) in [(Role::Router, "listen", listen), (Role::Server, "connect", connect)] {
            let text = configs::with_passwords(role, &options, "secret", Path::new("users"));
            let config = zenoh::Config::from_json5(&text).unwrap();
            assert_eq!(config.get_json(&format!("{key}/endpoints")).unwrap(), expected, "{role:?} {:?}", options.hosts);
        }
    }
}

/// Zenoh itself admits 1,000 programs to a router, and refuses the next one.
#[test]
fn a_router_admits_a_whole_fleet() {
    let options = options("fleet", Authentication::Passwords);
    let limit = |role| {
        let config = zenoh::Config::from_json5(&configs::with_passwords(role, &options, "secret", Path::new("users")));
        config.unwrap().get_json("transport/unicast/max_sessions").unwrap().parse::<u32>().unwrap()
    };
    assert_eq!((limit(Role::Router), limit(Role::Server)), (10_000, 1_000));
}

/// Zenoh's QUIC compares no certificate with an IPv6 address: programs would wait for ever.
#[test]
fn an_ipv6_address_needs_a_name_beside_a_certificate() {
    let with = |hosts: &[&str], authentication| {
        let hosts = hosts.iter().map(ToString::to_string).collect();
        make(&KeysOptions { hosts, ..options("ipv6", authentication) })
    };
    let error = with(&["::1"], Authentication::Certificates).unwrap_err().to_string();
    assert!(error.contains("--host localhost --host ::1") && error.contains("--auth password"), "{error}");
    let made = with(&["localhost", "::1"], Authentication::Certificates).unwrap();
    assert!(made.commands.iter().any(|command| command.contains("router")));
}
