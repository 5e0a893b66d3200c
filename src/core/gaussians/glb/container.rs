//! The container of a binary glTF: its header, and a buffer of attributes one after the other.

use std::io::{self, Write};

use serde_json::{Map, Value, json};

/// "glTF", the version, and the types of the two chunks.
pub(super) const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
pub(super) const JSON_CHUNK: &[u8; 4] = b"JSON";
pub(super) const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

/// glTF's component types.
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
pub(super) const FLOAT: u32 = 5126;

/// glTF's targets of vertices and of indices.
const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;

/// A number for each vertex and component.
pub(crate) struct Attribute<'a> {
    semantic: String,
    /// How many of the four numbers count.
    width: usize,
    component: u32,
    row: Box<dyn Fn(usize) -> [f32; 4] + 'a>,
}

impl<'a> Attribute<'a> {
    /// 32-bit numbers.
    pub fn new(semantic: &str, width: usize, row: impl Fn(usize) -> [f32; 4] + 'a) -> Self {
        let (semantic, row) = (semantic.to_owned(), Box::new(row));
        Self { semantic, width, component: FLOAT, row }
    }

    /// Numbers from 0 to 1, in 16 bits.
    pub fn shares(semantic: &str, width: usize, row: impl Fn(usize) -> [f32; 4] + 'a) -> Self {
        Self { component: UNSIGNED_SHORT, ..Self::new(semantic, width, row) }
    }

    /// Bytes of a vertex.
    pub fn stride(&self) -> usize {
        self.width * if self.component == FLOAT { 4 } else { 2 }
    }

    fn write(&self, index: usize, out: &mut dyn Write) -> io::Result<()> {
        for value in &(self.row)(index)[..self.width] {
            if self.component == FLOAT {
                out.write_all(&value.to_le_bytes())?;
            } else {
                // The cast clamps values outside the range.
                let share = (value * f32::from(u16::MAX)).round() as u16;
                out.write_all(&share.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn accessor(&self, view: usize, count: usize) -> Value {
        let kind = if self.width == 1 { "SCALAR" } else { &format!("VEC{}", self.width) };
        let mut accessor = json!({
            "bufferView": view, "componentType": self.component, "count": count, "type": kind
        });
        if self.component != FLOAT {
            accessor["normalized"] = true.into();
        }
        if self.semantic == "POSITION" {
            let rows = || (0..count).map(|index| (self.row)(index));
            let end = |pick: fn(f32, f32) -> f32| {
                let end = rows().reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])));
                end.map(|end| end[..self.width].to_vec())
            };
            accessor["min"] = json!(end(f32::min));
            accessor["max"] = json!(end(f32::max));
        }
        accessor
    }
}

/// The JSON of a buffer.
pub(crate) struct Layout {
    /// Its parts.
    pub views: Vec<Value>,
    /// The meaning of each part.
    pub accessors: Vec<Value>,
    /// The accessor of each attribute.
    pub names: Map<String, Value>,
    /// Bytes of the buffer.
    pub length: usize,
}

impl Layout {
    /// Attributes of `count` vertices, one after the other.
    pub fn of(attributes: &[Attribute<'_>], count: usize) -> Self {
        let (views, accessors) = (Vec::new(), Vec::new());
        let mut layout = Self { views, accessors, names: Map::new(), length: 0 };
        for attribute in attributes {
            let number = layout.part(attribute.stride() * count, ARRAY_BUFFER);
            layout.accessors.push(attribute.accessor(number, count));
            layout.names.insert(attribute.semantic.clone(), number.into());
        }
        layout
    }

    /// Adds `count` indices of 32 bits after them, and says their accessor.
    pub fn indices(&mut self, count: usize) -> usize {
        let number = self.part(4 * count, ELEMENT_ARRAY_BUFFER);
        self.accessors.push(json!({
            "bufferView": number, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"
        }));
        number
    }

    fn part(&mut self, bytes: usize, target: u32) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.length, "byteLength": bytes, "target": target
        }));
        self.length += bytes;
        self.views.len() - 1
    }
}

/// Writes all that is before a buffer of `length` bytes.
///
/// # Errors
/// Those of the writer, and if the file is larger than glTF allows.
pub(crate) fn write_header(document: &Value, length: usize, out: &mut dyn Write) -> io::Result<()> {
    let mut text = document.to_string();
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    let too_long = |_| io::Error::other("the scene is larger than the 4 GiB of a binary glTF");
    let whole = u32::try_from(12 + 8 + text.len() + 8 + length).map_err(too_long)?;
    out.write_all(MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&whole.to_le_bytes())?;
    for (kind, length) in [(JSON_CHUNK, text.len()), (BINARY_CHUNK, length)] {
        out.write_all(&(length as u32).to_le_bytes())?;
        out.write_all(kind)?;
        if kind == JSON_CHUNK {
            out.write_all(text.as_bytes())?;
        }
    }
    Ok(())
}

/// Writes the attributes of `count` vertices into the buffer.
///
/// # Errors
/// Those of the writer.
pub(crate) fn write_attributes(
    attributes: &[Attribute<'_>],
    count: usize,
    out: &mut dyn Write,
) -> io::Result<()> {
    for attribute in attributes {
        for index in 0..count {
            attribute.write(index, out)?;
        }
    }
    Ok(())
}
