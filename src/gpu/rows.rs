//! Arrays of rows, split into parts if they exceed the adapter's binding limit.

use bytemuck::Pod;

use crate::{Buffer, Gpu, GpuError};

/// Rows of equal length. If all of them exceed the adapter's binding limit, they are split into
/// several buffers, and a kernel is dispatched once per part.
#[derive(Clone)]
pub struct Rows<T> {
    parts: Vec<Buffer<T>>,
    /// Elements per row.
    length: usize,
    /// Rows per part, except in the last.
    per_part: usize,
}

impl<T: Pod> Rows<T> {
    /// The buffer of each part, in order.
    pub fn parts(&self) -> &[Buffer<T>] {
        &self.parts
    }

    /// Writes whole rows from the first on, before all work submitted later.
    ///
    /// # Errors
    /// As [`Buffer::write_at`].
    pub fn write(&self, values: &[T]) -> Result<(), GpuError> {
        let mut rest = values;
        for part in &self.parts {
            let (here, after) = rest.split_at(rest.len().min(part.len()));
            part.write(here)?;
            rest = after;
        }
        if rest.is_empty() {
            Ok(())
        } else {
            Err(GpuError::Validation("a write past the last row".to_owned()))
        }
    }

    /// Reads the first `rows`, after all work submitted before.
    ///
    /// # Errors
    /// A device error, or [`GpuError::Validation`] past the end.
    pub fn read(&self, rows: usize) -> Result<Vec<T>, GpuError> {
        let mut values = Vec::with_capacity(rows * self.length);
        for part in &self.parts {
            let missing = rows * self.length - values.len();
            values.extend(part.start_read(missing.min(part.len()))?.wait()?);
        }
        if values.len() == rows * self.length {
            return Ok(values);
        }
        Err(GpuError::Validation(format!("a read of {rows} rows past the last")))
    }

    /// Sets every byte to zero, before all work submitted later.
    ///
    /// # Errors
    /// A device error.
    pub fn clear(&self) -> Result<(), GpuError> {
        self.parts.iter().try_for_each(Buffer::clear)
    }

    /// Elements per row.
    pub fn length(&self) -> usize {
        self.length
    }
}

impl Gpu {
    /// Number of rows of at most `bytes` each that the adapter can bind at once; at least one,
    /// which may then be [`GpuError::TooLarge`].
    pub fn rows_per_part(&self, bytes: usize) -> usize {
        ((self.describe().max_binding / bytes.max(1) as u64) as usize).max(1)
    }

    /// Creates `rows` zeroed rows of `length` elements in parts of `per_part`; at least one part.
    /// Arrays that a kernel reads together need the same `per_part`: [`Gpu::rows_per_part`] of the
    /// longest row.
    ///
    /// # Errors
    /// As [`Gpu::create`].
    pub fn create_rows<T: Pod>(
        &self,
        label: &'static str,
        rows: usize,
        length: usize,
        per_part: usize,
    ) -> Result<Rows<T>, GpuError> {
        let sizes = part_sizes(rows, per_part);
        let parts =
            sizes.map(|here| self.create(label, here * length)).collect::<Result<_, _>>()?;
        Ok(Rows { parts, length, per_part })
    }
}

impl<T> Rows<T> {
    /// Rows per part, except in the last.
    pub fn per_part(&self) -> usize {
        self.per_part
    }
}

/// Number of rows in each part, at most `per_part`.
pub fn part_sizes(rows: usize, per_part: usize) -> impl Iterator<Item = usize> {
    let count = rows.div_ceil(per_part).max(1);
    (0..count).map(move |part| (rows - part * per_part).min(per_part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_rows_are_written_and_read_as_one() {
        let gpu = Gpu::new("auto").expect("an adapter");
        let rows = gpu.create_rows::<u32>("rows", 7, 3, 3).expect("created");
        assert_eq!(rows.parts().iter().map(Buffer::len).collect::<Vec<_>>(), [9, 9, 3]);
        let values: Vec<u32> = (0..21).collect();
        rows.write(&values).expect("written");
        assert_eq!(rows.read(7).expect("read"), values);
        assert_eq!(rows.read(4).expect("read"), values[..12]);
        assert_eq!(rows.parts()[1].read().expect("read"), values[9..18]);
        rows.write(&[99; 12]).expect("written");
        assert_eq!(rows.read(5).expect("read")[10..], [99, 99, 12, 13, 14]);
        assert!(rows.read(8).is_err() && rows.write(&[0; 22]).is_err());
        rows.clear().expect("cleared");
        assert_eq!(rows.read(7).expect("read"), [0; 21]);
        assert_eq!(part_sizes(0, 3).collect::<Vec<_>>(), [0]);
    }

    #[test]
    fn a_lower_binding_limit_takes_more_parts() {
        let gpu = Gpu::binding_at_most("auto", 4_096).expect("an adapter");
        assert_eq!((gpu.describe().max_binding, gpu.rows_per_part(96)), (4_096, 42));
        assert_eq!(gpu.rows_per_part(10_000), 1);
        assert!(matches!(
            gpu.create::<u32>("too much", 1_025),
            Err(GpuError::TooLarge { limit: 4_096, .. })
        ));
    }
}
