use fiatlux_bridge::ModelChunk;

use super::*;

/// The record has the whole chunk once, within the protocol's limits, and the origin of each action.
#[test]
fn a_note_becomes_a_record_within_bounds() {
    assert_eq!(Note::default().record(), None);
    let part = |key: &str, width: usize, rows: usize| (key.to_owned(), width, vec![0.5; width * rows]);
    let chunk = ModelChunk { rows: 30, parts: vec![part("left_arm", 7, 30), part("waist", 3, 30)], server_s: None };
    let note = |chunk, problem: &str| Note {
        chunk: Some(chunk),
        latency_s: 0.2,
        server_s: Some(0.145),
        problem: problem.into(),
        played: Some((2, 4, 5)),
    };
    let record = note(chunk, "").record().expect("a record");
    assert_eq!((record.index, record.row, record.values.len(), record.width), (2, 4, 300, 10));
    assert_eq!(record.keys, ["left_arm:7", "waist:3"]);
    assert!((record.age_s - 0.1).abs() < 1e-12);
    let large = ModelChunk { rows: 400, parts: vec![part("all", 512, 400)], server_s: None };
    let record = note(large, &"ü".repeat(300)).record().expect("a record");
    assert_eq!((record.values.len(), record.width, record.problem.len()), (0, 0, 256));
}

#[test]
fn flags_that_are_missing_are_told() {
    let error = |args: VlaArgs| args.source(false).err().map(|error| format!("{error} {error:?}")).unwrap_or_default();
    assert!(error(VlaArgs::default()).contains("--dialect and --model"));
    let model = |map: Option<&str>, url: &str| VlaArgs {
        dialect: Some(fiatlux_bridge::Dialect::Gr00t),
        model: Some(url.into()),
        map: map.map(str::to_owned),
        ..VlaArgs::default()
    };
    assert!(error(model(None, "ws://lab:1")).contains("Address"));
    assert!(error(model(Some("openpi_g1"), "tcp://lab:1")).contains("it is not for gr00t"));
    assert!(error(VlaArgs { prefix: Some(31), ..model(None, "tcp://lab:1") }).contains("a chunk has 30 rows"));
    assert!(error(model(None, "tcp://lab:1")).is_empty());
    let on = |controller: &str| VlaArgs { controller: Some(controller.into()), ..model(None, "tcp://lab:1") };
    assert!(error(on("own")).is_empty());
    for controller in ["sonic:x", "gear", "gear:", "own:x", "walk"] {
        let said = error(on(controller));
        assert!(said.contains(&format!("'{controller}', but the mapping unitree_g1 outputs commands")), "{said}");
    }
    assert!(error(on("gear:/nowhere")).contains("/nowhere/Balance.onnx"));
    assert!(error(on("gear:/nowhere,vx=1")).contains("use names of reading, gains"));
}
