//! Tables of numbers in NumPy's format (NEP 1): float64 or float32, two dimensions.

/// Position of the header's length, by format version.
const LENGTH_AT: usize = 8;
const MAGIC: &[u8] = b"\x93NUMPY";

/// A table, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub columns: usize,
    pub values: Vec<f64>,
}

impl Table {
    pub fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.columns.max(1))
    }

    /// Reads a file's content. Allocates no more memory than its values need.
    ///
    /// # Errors
    /// The reason, for the user.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let (header, values) = parts(bytes).ok_or("it is cut short, or no array")?;
        let no_table = "it is no array of two dimensions";
        let [rows, columns] = shape(header).ok_or(no_table)?;
        let number = |width: usize| -> Result<Vec<&[u8]>, String> {
            let size = rows.checked_mul(columns).and_then(|n| n.checked_mul(width));
            let size = size.filter(|&size| size > 0).ok_or(no_table)?;
            let values = values.get(..size).ok_or("it is cut short")?;
            Ok(values.chunks_exact(width).collect())
        };
        let values: Vec<f64> = match field(header, "descr") {
            Some("'<f8'") => number(8)?.into_iter().map(|b| f64::from_le_bytes(array(b))).collect(),
            Some("'>f8'") => number(8)?.into_iter().map(|b| f64::from_be_bytes(array(b))).collect(),
            Some("'<f4'") => {
                number(4)?.into_iter().map(|b| f32::from_le_bytes(array(b)).into()).collect()
            }
            Some("'>f4'") => {
                number(4)?.into_iter().map(|b| f32::from_be_bytes(array(b)).into()).collect()
            }
            _ => return Err("its numbers are neither float64 nor float32".to_owned()),
        };
        let values = match field(header, "fortran_order") {
            Some("True") => {
                (0..values.len()).map(|at| values[at % columns * rows + at / columns]).collect()
            }
            _ => values,
        };
        Ok(Self { columns, values })
    }

    /// The content of a file, as float64.
    pub fn to_bytes(&self) -> Vec<u8> {
        let rows = self.values.len() / self.columns.max(1);
        let header = format!(
            "{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, {}), }}",
            self.columns
        );
        // The values begin at a multiple of 64 bytes.
        let length = (LENGTH_AT + 2 + header.len() + 1).next_multiple_of(64) - LENGTH_AT - 2;
        let mut bytes = [MAGIC, &[1, 0], &(length as u16).to_le_bytes()].concat();
        bytes.extend(format!("{header:<0$}\n", length - 1).bytes());
        bytes.extend(self.values.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }
}

/// The header and the bytes after it.
fn parts(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(MAGIC)?;
    let (length, rest) = match rest.first()? {
        1 => {
            let (length, rest) = rest.get(2..)?.split_first_chunk()?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        _ => {
            let (length, rest) = rest.get(2..)?.split_first_chunk()?;
            (u32::from_le_bytes(*length) as usize, rest)
        }
    };
    let (header, values) = rest.split_at_checked(length)?;
    Some((str::from_utf8(header).ok()?, values))
}

/// The value of a key of the header, which is a dictionary in Python syntax.
fn field<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, after) = header.split_once(&format!("'{key}':"))?;
    let after = after.trim_start();
    let end = match after.starts_with('(') {
        true => after.find(')')? + 1,
        false => after.find([',', '}'])?,
    };
    Some(after[..end].trim_end())
}

fn shape(header: &str) -> Option<[usize; 2]> {
    let numbers = field(header, "shape")?.strip_prefix('(')?.strip_suffix(')')?;
    let (rows, columns) = numbers.split_once(',')?;
    Some([rows.trim().parse().ok()?, columns.trim().parse().ok()?])
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().expect("chunks of this size")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_width_and_order_gives_the_same_table() {
        let table = Table { columns: 3, values: (0..6).map(f64::from).collect() };
        assert_eq!(Table::parse(&table.to_bytes()), Ok(table.clone()));
        let file = |version: u8, number: &str, order: &str, values: Vec<u8>| {
            let header =
                format!("{{'descr': '{number}', 'fortran_order': {order}, 'shape': (2, 3), }}\n");
            let length = (header.len() as u32).to_le_bytes();
            let length = if version == 1 { &length[..2] } else { &length };
            [MAGIC, &[version, 0], length, header.as_bytes(), &values].concat()
        };
        let values = || table.values.iter().copied();
        let by_columns = [0.0_f64, 3.0, 1.0, 4.0, 2.0, 5.0];
        for bytes in [
            file(1, ">f8", "False", values().flat_map(f64::to_be_bytes).collect()),
            file(2, "<f4", "False", values().flat_map(|v| (v as f32).to_le_bytes()).collect()),
            file(3, ">f4", "False", values().flat_map(|v| (v as f32).to_be_bytes()).collect()),
            file(1, "<f8", "True", by_columns.into_iter().flat_map(f64::to_le_bytes).collect()),
        ] {
            assert_eq!(Table::parse(&bytes), Ok(table.clone()));
        }
    }
}
