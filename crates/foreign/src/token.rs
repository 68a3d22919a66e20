//! Tokens, the commands for GEAR-SONIC's decoder.

use std::io::ErrorKind;
use std::path::Path;

use crate::ForeignError;

/// Number of values of a token.
pub const TOKEN: usize = 64;
/// Maximum absolute value in a token; the makers' client skips motions beyond it. An encoder gives -1 to 1.
pub const TOKEN_LIMIT: f32 = 1.25;
/// Maximum size of a file, bytes: 20 hours of tokens.
const FILE_LIMIT: u64 = 1 << 30;

/// A motion in the code of an encoder or a model.
pub type Token = [f32; TOKEN];

pub trait TokenSource: Send {
    /// The token of a control step, which counts from 0 in each episode.
    ///
    /// # Errors
    /// The source has no token for the step; the episode ends.
    fn token(&mut self, step: u64) -> Result<Token, ForeignError>;
}

/// A source that gives the same token in every step.
#[derive(Debug, Clone)]
pub struct FixedToken(pub Token);

impl Default for FixedToken {
    /// All zeros: the middle of the code book, which need not be a useful motion.
    fn default() -> Self {
        Self([0.0; TOKEN])
    }
}

impl TokenSource for FixedToken {
    fn token(&mut self, _step: u64) -> Result<Token, ForeignError> {
        Ok(self.0)
    }
}

/// A recorded sequence; after its end, its last token repeats.
#[derive(Debug, Clone)]
pub struct RecordedTokens {
    tokens: Vec<Token>,
}

impl RecordedTokens {
    /// Reads a text file with one token on each line: 64 numbers, separated by spaces or commas, as `numpy.savetxt`
    /// writes them. Empty lines and lines that begin with `#` are ignored.
    pub fn read(path: &Path) -> Result<Self, ForeignError> {
        let text = fiatlux_files::read_stream(path, FILE_LIMIT).map_err(|source| match source.kind() {
            ErrorKind::FileTooLarge => ForeignError::FileSize { path: path.into(), most: FILE_LIMIT },
            _ => ForeignError::Read { path: path.into(), source },
        })?;
        let mut tokens = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let wrong = |problem| ForeignError::Tokens { path: path.into(), line: index + 1, problem };
            if line.trim().is_empty() || line.trim_start().starts_with('#') {
                continue;
            }
            let words =
                line.split(|letter: char| letter == ',' || letter.is_whitespace()).filter(|word| !word.is_empty());
            let mut token = [0.0; TOKEN];
            let mut count = 0;
            for word in words {
                let number = word.parse().map_err(|_| wrong(format!("'{word}' is not a number")))?;
                if let Some(place) = token.get_mut(count) {
                    *place = number;
                }
                count += 1;
            }
            if count != TOKEN {
                return Err(wrong(format!("it has {count} numbers")));
            }
            check(&token).map_err(|error| wrong(error.to_string()))?;
            tokens.push(token);
        }
        match tokens.is_empty() {
            false => Ok(Self { tokens }),
            true => Err(ForeignError::Tokens { path: path.into(), line: 1, problem: "it has no token".into() }),
        }
    }
}

impl TokenSource for RecordedTokens {
    fn token(&mut self, step: u64) -> Result<Token, ForeignError> {
        let last = self.tokens.len() - 1;
        Ok(self.tokens[usize::try_from(step).map_or(last, |step| step.min(last))])
    }
}

/// Makes a token from a model's numbers.
pub fn token_of(numbers: &[f64]) -> Result<Token, ForeignError> {
    let numbers: &[f64; TOKEN] = numbers.try_into().map_err(|_| ForeignError::Width { found: numbers.len() })?;
    let token = numbers.map(|number| number as f32);
    check(&token).map(|()| token)
}

/// Refuses values that are not finite or exceed the limit.
pub(crate) fn check(token: &Token) -> Result<(), ForeignError> {
    match token.iter().position(|value| value.is_nan() || value.abs() > TOKEN_LIMIT) {
        None => Ok(()),
        Some(index) => Err(ForeignError::Token { index, value: token[index], most: TOKEN_LIMIT }),
    }
}
