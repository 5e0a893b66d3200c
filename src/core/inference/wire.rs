//! The files of weights that an ONNX file names, read from its protocol buffers.
//!
//! ONNX Runtime has no call that lists them, and would read missing ones from the current folder.

use std::collections::BTreeSet;

use super::file::ONE_FILE;

/// The messages of onnx.proto through which a tensor can be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Message {
    Model,
    Training,
    Function,
    Graph,
    Node,
    Attribute,
    Sparse,
    Tensor,
}

/// Number and message of each field that leads to a tensor, by the enclosing message.
const FIELDS: [(Message, u64, Message); 19] = {
    use Message::{Attribute, Function, Graph, Model, Node, Sparse, Tensor, Training};
    [
        (Model, 7, Graph),
        (Model, 20, Training),
        (Model, 25, Function),
        (Training, 1, Graph),
        (Training, 2, Graph),
        (Function, 7, Node),
        (Function, 11, Attribute),
        (Graph, 1, Node),
        (Graph, 5, Tensor),
        (Graph, 15, Sparse),
        (Node, 5, Attribute),
        (Attribute, 5, Tensor),
        (Attribute, 6, Graph),
        (Attribute, 10, Tensor),
        (Attribute, 11, Graph),
        (Attribute, 22, Sparse),
        (Attribute, 23, Sparse),
        (Sparse, 1, Tensor),
        (Sparse, 2, Tensor),
    ]
};

/// Maximum nesting of messages; protocol buffer readers have the same limit.
const DEEPEST: usize = 100;

/// The names of the files with a network's weights, relative to its folder.
///
/// # Errors
/// A sentence if the file is not an ONNX file, or if a tensor other than a weight of its main graph
/// is external: ONNX Runtime takes only those from memory.
pub(super) fn weight_files(bytes: &[u8]) -> Result<BTreeSet<String>, String> {
    let mut found = Found::default();
    if bytes.is_empty() || found.walk(bytes, Message::Model, 0).is_none() {
        return Err("it is no ONNX file, or damaged".to_owned());
    }
    match found.inner {
        Some(name) => {
            Err(format!("a constant or an inner graph of it lies in `{name}`: {ONE_FILE}"))
        }
        None => Ok(found.weights),
    }
}

#[derive(Default)]
struct Found {
    weights: BTreeSet<String>,
    /// The file of a tensor that is not a weight of the main graph.
    inner: Option<String>,
}

impl Found {
    /// Visits all tensors; `None` if the bytes are not such a message.
    fn walk(&mut self, bytes: &[u8], message: Message, depth: usize) -> Option<()> {
        if depth > DEEPEST {
            return None;
        }
        for field in fields(bytes) {
            let (number, value) = field?;
            let Value::Bytes(content) = value else { continue };
            let inner = FIELDS.iter().find(|(of, at, _)| (*of, *at) == (message, number));
            match inner {
                Some((_, _, Message::Tensor)) => match file_of(content)? {
                    // The main graph is in the model.
                    Some(name) if message == Message::Graph && depth == 1 => {
                        self.weights.insert(name);
                    }
                    Some(name) => self.inner = Some(name),
                    None => {}
                },
                Some(&(_, _, inner)) => self.walk(content, inner, depth + 1)?,
                None => {}
            }
        }
        Some(())
    }
}

/// The file with a tensor's values; the inner `None` if the tensor contains them itself.
fn file_of(tensor: &[u8]) -> Option<Option<String>> {
    const EXTERNAL: u64 = 1;
    let (mut is_external, mut location) = (false, String::new());
    for field in fields(tensor) {
        match field? {
            (13, Value::Bytes(entry)) => {
                let (mut key, mut value) = (&b""[..], &b""[..]);
                for field in fields(entry) {
                    match field? {
                        (1, Value::Bytes(text)) => key = text,
                        (2, Value::Bytes(text)) => value = text,
                        _ => {}
                    }
                }
                if key == b"location" {
                    location = std::str::from_utf8(value).ok()?.to_owned();
                }
            }
            (14, Value::Number(place)) => is_external = place == EXTERNAL,
            _ => {}
        }
    }
    Some(is_external.then_some(location))
}

enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    /// A value of fixed width, which no field of interest has.
    Fixed,
}

/// The fields of a message, by number; a final `None` if the bytes are not a message.
fn fields(bytes: &[u8]) -> impl Iterator<Item = Option<(u64, Value<'_>)>> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let field = field(&mut rest);
        if field.is_none() {
            rest = &[];
        }
        Some(field)
    })
}

fn field<'a>(rest: &mut &'a [u8]) -> Option<(u64, Value<'a>)> {
    let tag = varint(rest)?;
    let value = match tag & 7 {
        0 => Value::Number(varint(rest)?),
        1 => rest.split_off(..8).map(|_| Value::Fixed)?,
        2 => {
            let length = usize::try_from(varint(rest)?).ok()?;
            Value::Bytes(rest.split_off(..length)?)
        }
        5 => rest.split_off(..4).map(|_| Value::Fixed)?,
        _ => return None,
    };
    Some((tag >> 3, value))
}

/// A number of up to ten bytes, seven bits each, least significant first.
fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..70).step_by(7) {
        let byte = *rest.split_off_first()?;
        number |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field with bytes, shorter than 128.
    fn field(number: u8, content: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, content.len() as u8], content].concat()
    }

    fn tensor(location: &str) -> Vec<u8> {
        let entry = [field(1, b"location"), field(2, location.as_bytes())].concat();
        [field(13, &entry), vec![14 << 3, 1]].concat()
    }

    fn files(model: &[u8]) -> Result<Vec<String>, String> {
        weight_files(model).map(|files| files.into_iter().collect())
    }

    #[test]
    fn the_files_of_weights_are_found_and_each_once() {
        let weights = [tensor("b"), tensor("a/c"), tensor("b")].map(|t| field(5, &t)).concat();
        assert_eq!(files(&field(7, &weights)).as_deref(), Ok(&["a/c".into(), "b".into()][..]));
        let mut within = tensor("b");
        *within.last_mut().expect("a place") = 0;
        assert_eq!(files(&field(7, &field(5, &within))).as_deref(), Ok(&[][..]));
    }

    #[test]
    fn tensors_other_than_weights_may_not_be_external() {
        let attribute = |content: Vec<u8>| field(7, &field(1, &field(5, &content)));
        let inner = field(5, &tensor("w"));
        for model in [attribute(field(5, &tensor("w"))), attribute(field(6, &inner))] {
            let refused = files(&model).expect_err("refused");
            assert!(
                refused.contains("`w`") && refused.contains("external_data=False"),
                "{refused}"
            );
        }
    }

    #[test]
    fn invalid_messages_are_refused_at_every_length() {
        let whole = field(7, &field(5, &tensor("weights.data")));
        for length in 0..whole.len() {
            assert!(files(&whole[..length]).is_err(), "{length}");
        }
        for bytes in [&b"content"[..], &[0xff; 12], &[0x3a, 0xff, 0xff, 0xff, 0xff, 0x0f]] {
            assert!(files(bytes).is_err(), "{bytes:?}");
        }
    }
}
