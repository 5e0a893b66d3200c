//! The kernel table: Rust's description of a shader, checked against the shader itself.

use std::borrow::Cow;

use crate::reflect::{self, Access, Reflection};
use crate::{GpuError, shader};

/// One binding of a kernel; its index in the table is its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Binding {
    /// Name of the variable in the shader.
    pub name: &'static str,
    pub access: Access,
}

/// A uniform binding.
pub const fn uniform(name: &'static str) -> Binding {
    Binding { name, access: Access::Uniform }
}

/// A read-only storage binding.
pub const fn read(name: &'static str) -> Binding {
    Binding { name, access: Access::Read }
}

/// A writable storage binding.
pub const fn read_write(name: &'static str) -> Binding {
    Binding { name, access: Access::ReadWrite }
}

/// A row of a kernel table: one shader file with the entry point `main`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Kernel {
    /// `family/verb`: the file `shaders/family/verb.wgsl`, and the label in traces.
    pub name: &'static str,
    /// Bindings of group 0, from binding 0.
    pub bindings: &'static [Binding],
    /// Values that replace those of `const` lines in the shader's text.
    pub constants: Cow<'static, [(&'static str, u32)]>,
    /// Whether the shader is compiled without naga's bounds and loop checks; see
    /// [`Kernel::unchecked`].
    pub unchecked: bool,
}

impl Kernel {
    /// A row without replaced constants.
    pub const fn new(name: &'static str, bindings: &'static [Binding]) -> Self {
        Self { name, bindings, constants: Cow::Borrowed(&[]), unchecked: false }
    }

    /// Disables naga's run-time checks. Only for a kernel in which every index is below its array's
    /// length and every loop ends, whatever the buffers hold, and where a measurement shows a gain:
    /// a checked index into a private array keeps the driver from unrolling the loop around it.
    pub const fn unchecked(mut self) -> Self {
        self.unchecked = true;
        self
    }

    /// A copy of the kernel with replaced constants.
    #[must_use]
    pub fn with(&self, constants: &[(&'static str, u32)]) -> Self {
        let mut all = self.constants.to_vec();
        all.extend_from_slice(constants);
        Self { constants: Cow::Owned(all), ..self.clone() }
    }

    /// The shader's text and declarations, after checking them against this row.
    ///
    /// # Errors
    /// [`GpuError::Shader`] for an invalid text, a missing entry point, or different bindings.
    pub fn reflect(&self) -> Result<(String, Reflection), GpuError> {
        let fault = |message| Err(GpuError::Shader { name: self.name.to_owned(), message });
        let text = shader::expand(self.name, &self.constants)?;
        let found = reflect::reflect(self.name, &text)?;
        if found.workgroup == [0; 3] {
            return fault("no entry point `main`".to_owned());
        }
        let numbered = found.bindings.iter().enumerate().all(|(i, b)| b.number as usize == i);
        let equal = found.bindings.iter().map(|b| (b.name.as_str(), b.access));
        if !numbered || !equal.eq(self.bindings.iter().map(|b| (b.name, b.access))) {
            return fault(format!(
                "declares {:?}, the table says {:?}",
                found.bindings, self.bindings
            ));
        }
        Ok((text, found))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_contradicts_its_shader_is_refused() {
        const WRONG: Kernel =
            Kernel::new("shared/test_axpy", &[uniform("scale"), read("x"), read("out")]);
        assert!(matches!(WRONG.reflect(), Err(GpuError::Shader { .. })));
        let none = Kernel::new("shared/grid", &[]);
        assert!(
            matches!(none.reflect(), Err(GpuError::Shader { message, .. }) if message.contains("main"))
        );
    }
}
