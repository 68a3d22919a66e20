//! Reading tokens from a file.

use fiatlux_foreign::{FixedToken, RecordedTokens, TokenSource};

fn read(name: &str, text: &str) -> Result<RecordedTokens, String> {
    let path = std::env::temp_dir().join(format!("fiatlux-tokens-{name}-{}.txt", std::process::id()));
    std::fs::write(&path, text).unwrap();
    let read = RecordedTokens::read(&path).map_err(|error| error.to_string());
    std::fs::remove_file(path).unwrap();
    read
}

/// A line as `numpy.savetxt` writes it.
fn line(value: f64, separator: &str) -> String {
    vec![format!("{value:.18e}"); 64].join(separator)
}

#[test]
fn recorded_tokens_play_in_order_and_the_last_one_holds() {
    let text = format!("# two tokens\n{}\n\n{}\n", line(0.25, " "), line(-1.0, ","));
    let mut tokens = read("order", &text).unwrap();
    let played: Vec<f32> = [0, 1, 2, u64::MAX].map(|step| tokens.token(step).unwrap()[63]).into();
    assert_eq!(played, [0.25, -1.0, -1.0, -1.0]);
    assert_eq!(FixedToken::default().token(9).unwrap(), [0.0; 64]);
}

#[test]
fn wrong_lines_are_named() {
    let good = line(0.5, " ");
    for (name, text, words) in [
        ("short", format!("{good}\n0.5 0.5\n"), ["line 2", "it has 2 numbers"]),
        ("long", format!("{good} 0.5\n"), ["line 1", "it has 65 numbers"]),
        ("word", good.replacen("5", "x", 1), ["line 1", "is not a number"]),
        ("large", line(1.5, " "), ["line 1", "number 0 of the token is 1.5"]),
        ("nan", line(f64::NAN, " "), ["line 1", "NaN"]),
        ("empty", "# nothing\n".into(), ["line 1", "it has no token"]),
    ] {
        let message = read(name, &text).unwrap_err();
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
}
