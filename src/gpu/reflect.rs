//! A shader's declarations, parsed by naga, so that tests can compare them with Rust.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, StorageAccess, TypeInner};

use crate::GpuError;

/// The access of a kernel to a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Access {
    /// `var<uniform>`
    Uniform,
    /// `var<storage, read>`
    Read,
    /// `var<storage, read_write>`
    ReadWrite,
}

/// The declarations of one shader.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reflection {
    /// Bindings of group 0, by number.
    pub bindings: Vec<ReflectedBinding>,
    /// Invocations per workgroup of the entry point `main`; zeros without one.
    pub workgroup: [u32; 3],
    /// Bytes of workgroup memory.
    pub workgroup_bytes: u32,
    /// Whether it uses subgroups.
    pub uses_subgroups: bool,
    /// All declared structs.
    pub structs: Vec<ReflectedStruct>,
    /// All scalar module constants, as f64.
    pub constants: Vec<(String, f64)>,
}

/// One binding of a shader.
#[derive(Clone, Debug, PartialEq)]
pub struct ReflectedBinding {
    /// `@binding(number)`.
    pub number: u32,
    /// Name of the variable.
    pub name: String,
    pub access: Access,
    /// Bytes per element of a run-time sized array, or of the whole type.
    pub stride: u32,
}

/// The memory layout of one struct.
#[derive(Clone, Debug, PartialEq)]
pub struct ReflectedStruct {
    /// Name of the type.
    pub name: String,
    /// Bytes, padding included.
    pub size: u32,
    /// Name and byte offset of each member.
    pub members: Vec<(String, u32)>,
}

impl Reflection {
    pub fn structure(&self, name: &str) -> Option<&ReflectedStruct> {
        self.structs.iter().find(|s| s.name == name)
    }

    pub fn constant(&self, name: &str) -> Option<f64> {
        self.constants.iter().find(|(other, _)| other == name).map(|(_, value)| *value)
    }
}

/// Parses and validates a shader with all capabilities that this crate may request of a device.
///
/// # Errors
/// [`GpuError::Shader`] with naga's message.
pub fn validate(name: &str, text: &str) -> Result<naga::Module, GpuError> {
    let fault = |message: String| GpuError::Shader { name: name.to_owned(), message };
    let module = naga::front::wgsl::parse_str(text)
        .map_err(|e| fault(e.emit_to_string_with_path(text, name)))?;
    let capabilities = Capabilities::SUBGROUP | Capabilities::SUBGROUP_BARRIER;
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .map_err(|e| fault(e.emit_to_string_with_path(text, name)))?;
    Ok(module)
}

/// The declarations of a shader text with expanded imports.
///
/// # Errors
/// [`GpuError::Shader`] when the text is not valid.
pub fn reflect(name: &str, text: &str) -> Result<Reflection, GpuError> {
    let module = validate(name, text)?;
    let workgroup =
        module.entry_points.iter().find(|e| e.name == "main").map_or([0; 3], |e| e.workgroup_size);
    Ok(Reflection {
        bindings: bindings(name, &module)?,
        workgroup,
        workgroup_bytes: workgroup_bytes(&module),
        uses_subgroups: is_refused_without_subgroups(&module),
        structs: structures(&module),
        constants: constants(&module),
    })
}

fn bindings(name: &str, module: &naga::Module) -> Result<Vec<ReflectedBinding>, GpuError> {
    let mut found = Vec::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = &variable.binding else {
            continue;
        };
        let access = match variable.space {
            AddressSpace::Uniform => Access::Uniform,
            AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => {
                Access::ReadWrite
            }
            AddressSpace::Storage { .. } => Access::Read,
            _ => continue,
        };
        if binding.group != 0 {
            return Err(GpuError::Shader {
                name: name.to_owned(),
                message: format!("a binding in group {}; only group 0 is used", binding.group),
            });
        }
        let inner = &module.types[variable.ty].inner;
        let stride = match inner {
            TypeInner::Array { stride, size: naga::ArraySize::Dynamic, .. } => *stride,
            _ => inner.size(module.to_ctx()),
        };
        let name = variable.name.clone().unwrap_or_default();
        found.push(ReflectedBinding { number: binding.binding, name, access, stride });
    }
    found.sort_by_key(|b| b.number);
    Ok(found)
}

fn workgroup_bytes(module: &naga::Module) -> u32 {
    let variables = module.global_variables.iter();
    let shared = variables.filter(|(_, variable)| variable.space == AddressSpace::WorkGroup);
    shared.map(|(_, variable)| module.types[variable.ty].inner.size(module.to_ctx())).sum()
}

fn is_refused_without_subgroups(module: &naga::Module) -> bool {
    Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(module).is_err()
}

fn structures(module: &naga::Module) -> Vec<ReflectedStruct> {
    let member = |m: &naga::StructMember| (m.name.clone().unwrap_or_default(), m.offset);
    let structure = |ty: &naga::Type| match &ty.inner {
        TypeInner::Struct { members, span } => Some(ReflectedStruct {
            name: ty.name.clone().unwrap_or_default(),
            size: *span,
            members: members.iter().map(member).collect(),
        }),
        _ => None,
    };
    module.types.iter().filter_map(|(_, ty)| structure(ty)).collect()
}

fn constants(module: &naga::Module) -> Vec<(String, f64)> {
    let value = |expression: &naga::Expression| match expression {
        naga::Expression::Literal(naga::Literal::F32(v)) => Some(f64::from(*v)),
        naga::Expression::Literal(naga::Literal::U32(v)) => Some(f64::from(*v)),
        naga::Expression::Literal(naga::Literal::I32(v)) => Some(f64::from(*v)),
        _ => None,
    };
    let constant =
        |c: &naga::Constant| Some((c.name.clone()?, value(&module.global_expressions[c.init])?));
    module.constants.iter().filter_map(|(_, c)| constant(c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shader;

    #[test]
    fn layouts_bindings_and_constants_of_a_shader_are_parsed() {
        let text = shader::expand("shared/test_axpy", &[("WIDTH", 32)]).expect("expands");
        let found = reflect("shared/test_axpy", &text).expect("valid");
        assert_eq!(found.workgroup, [32, 1, 1]);
        assert_eq!(found.constant("WIDTH"), Some(32.0));
        assert!(found.workgroup_bytes == 0 && !found.uses_subgroups);
        let scale = found.structure("TestScale").expect("declared");
        assert_eq!((scale.size, &scale.members[1]), (8, &("count".to_owned(), 4)));
        let names: Vec<_> =
            found.bindings.iter().map(|b| (b.name.as_str(), b.access, b.stride)).collect();
        assert_eq!(
            names,
            [("scale", Access::Uniform, 8), ("x", Access::Read, 4), ("out", Access::ReadWrite, 4)]
        );
    }
}
