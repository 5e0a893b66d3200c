//! JSON as Python writes it, and the fields of a frame.

use std::path::Path;

use serde_json::Value;
use serde_json::error::Category;

use crate::poses::{PoseFileError, text};

/// A JSON object.
pub(super) type Object = serde_json::Map<String, Value>;

/// What Python writes for values that are not JSON numbers.
const NO_NUMBERS: [&str; 3] = ["-Infinity", "Infinity", "NaN"];

/// The object in a file. Non-JSON numbers become strings of their names.
pub(super) fn read(file: &Path) -> Result<Object, PoseFileError> {
    let text = with_quoted_numbers(&text::read(file)?);
    let parsed: Result<Value, _> = serde_json::from_str(&text);
    let fault = |reason: String| PoseFileError::bad_file(file, reason);
    match parsed {
        Ok(Value::Object(object)) => Ok(object),
        Ok(_) => Err(fault("it holds no JSON object with `frames`".to_owned())),
        Err(error) => {
            let what = match error.classify() {
                Category::Eof => "it is cut short",
                _ => "it is not valid JSON",
            };
            Err(fault(format!("{what}, {}", place(&text, &error))))
        }
    }
}

/// Where the text stops being JSON, described for its author.
fn place(text: &str, error: &serde_json::Error) -> String {
    let lines = text.split_inclusive('\n');
    let before: usize = lines.take(error.line().saturating_sub(1)).map(str::len).sum();
    let mut end = (before + error.column()).min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let last = text[..end].rsplit_once("\"file_path\"").and_then(|(_, rest)| {
        let mut parts = rest.split('"');
        parts.next()?;
        parts.next()
    });
    match last {
        Some(name) => format!("in or after the frame {name} (line {})", error.line()),
        None => format!("before its first frame (line {})", error.line()),
    }
}

/// The text with quotes around non-JSON numbers.
fn with_quoted_numbers(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut in_string) = (text, false);
    while let Some(c) = rest.chars().next() {
        let word = NO_NUMBERS.iter().find(|word| !in_string && rest.starts_with(**word));
        let length = match (word, c) {
            (Some(word), _) => {
                out.push('"');
                out.push_str(word);
                out.push('"');
                rest = &rest[word.len()..];
                continue;
            }
            // An escaped character does not end a string.
            (None, '\\') if in_string => 1 + rest[1..].chars().next().map_or(0, char::len_utf8),
            _ => c.len_utf8(),
        };
        in_string ^= c == '"';
        out.push_str(&rest[..length]);
        rest = &rest[length..];
    }
    out
}

/// A number, including non-JSON ones.
pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) if NO_NUMBERS.contains(&&**text) => text.parse().ok(),
        _ => None,
    }
}

/// A frame's own fields, which take precedence over the file's.
pub(super) struct Fields<'a> {
    own: &'a Object,
    shared: &'a Object,
}

impl<'a> Fields<'a> {
    pub(super) fn new(own: &'a Object, shared: &'a Object) -> Self {
        Self { own, shared }
    }

    /// A field of the frame itself.
    pub(super) fn own(&self, key: &str) -> Option<&'a Value> {
        self.own.get(key).filter(|value| !value.is_null())
    }

    fn shared(&self, key: &str) -> Option<&'a Value> {
        self.shared.get(key).filter(|value| !value.is_null())
    }

    /// A field of the frame, or else of the file.
    pub(super) fn get(&self, key: &str) -> Option<&'a Value> {
        self.own(key).or_else(|| self.shared(key))
    }

    /// Whether the frame itself has one of `keys`.
    pub(super) fn has_own(&self, keys: &[&str]) -> bool {
        keys.iter().any(|key| self.own(key).is_some())
    }

    /// The fields of the frame alone if it has one of `keys`, else those of the file: related
    /// fields are not mixed.
    pub(super) fn together(&self, keys: &[&str]) -> Self {
        let object = match self.has_own(keys) {
            true => self.own,
            false => self.shared,
        };
        Self::new(object, object)
    }

    /// The fields of the file alone.
    pub(super) fn of_file(&self) -> Self {
        Self::new(self.shared, self.shared)
    }

    /// Whether a field is present and not `false`.
    pub(super) fn is_set(&self, key: &str) -> bool {
        !matches!(self.get(key), None | Some(Value::Bool(false)))
    }

    /// A finite number.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, String> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let number = number(value).filter(|number| number.is_finite());
        number.map(Some).ok_or_else(|| format!("`{key}` is {value} and not a number"))
    }

    /// Several numbers, 0 where they are missing.
    pub(super) fn numbers<const N: usize>(&self, keys: [&str; N]) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for (number, key) in numbers.iter_mut().zip(keys) {
            *number = self.number(key)?.unwrap_or(0.0);
        }
        Ok(numbers)
    }
}
