//! The embedded shaders and their only preprocessor: `#import family/name.wgsl` and constants.

use std::collections::HashSet;

use crate::GpuError;

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

/// Names of all embedded shaders, `family/verb`, sorted.
pub fn names() -> impl Iterator<Item = &'static str> {
    SOURCES.iter().map(|(name, _)| *name)
}

/// The text of one shader file, unchanged from `shaders/`.
///
/// # Errors
/// [`GpuError::Shader`] when there is no such file.
pub fn source(name: &str) -> Result<&'static str, GpuError> {
    SOURCES.binary_search_by(|(other, _)| (*other).cmp(name)).map(|index| SOURCES[index].1).map_err(
        |_| GpuError::Shader {
            name: name.to_owned(),
            message: "no such file in shaders/".to_owned(),
        },
    )
}

/// The text of a shader with every `#import` replaced, each file once, and the given constants set.
///
/// A constant `("PIXELS", 8)` replaces the value in the line `const PIXELS: u32 = 4;`. This
/// replaces WGSL's `override`, because the size of a private array must be textual, and one
/// mechanism for both is simpler.
///
/// # Errors
/// [`GpuError::Shader`] for an unknown file or a constant that the text does not declare.
pub fn expand(name: &str, constants: &[(&str, u32)]) -> Result<String, GpuError> {
    let mut text = String::new();
    import(name, &mut HashSet::new(), &mut text)?;
    for (constant, value) in constants {
        text = set_constant(&text, constant, *value).ok_or_else(|| GpuError::Shader {
            name: name.to_owned(),
            message: format!("no line `const {constant}: ... = ...;`"),
        })?;
    }
    Ok(text)
}

/// Appends the file `name`, with imported files in place of its import lines.
fn import<'a>(name: &'a str, seen: &mut HashSet<&'a str>, text: &mut String) -> Result<(), GpuError>
where
    'static: 'a,
{
    if !seen.insert(name) {
        return Ok(());
    }
    for line in source(name)?.lines() {
        match line.strip_prefix("#import ") {
            Some(file) => import(file.trim().trim_end_matches(".wgsl"), seen, text)?,
            None => {
                text.push_str(line);
                text.push('\n');
            }
        }
    }
    Ok(())
}

/// The text with the value of one constant replaced; `None` if it is not declared.
fn set_constant(text: &str, constant: &str, value: u32) -> Option<String> {
    let mut found = false;
    let lines = text.lines().map(|line| match declaration(line, constant) {
        Some(head) => {
            found = true;
            format!("{head}= {value};")
        }
        None => line.to_owned(),
    });
    let text = lines.collect::<Vec<_>>().join("\n") + "\n";
    found.then_some(text)
}

/// The text before the `=` of a line that declares this constant.
fn declaration<'a>(line: &'a str, constant: &str) -> Option<&'a str> {
    let rest = line.strip_prefix("const ")?.strip_prefix(constant)?;
    rest.starts_with([':', ' ']).then(|| line.split('=').next())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflect;

    #[test]
    fn every_shader_is_valid_and_every_shared_file_is_used() {
        let mut used = HashSet::new();
        let shared = |name: &&str| name.starts_with("shared/") && !name.starts_with("shared/test_");
        for name in names().filter(|name| !shared(name)) {
            import(name, &mut used, &mut String::new()).expect("imports resolve");
            let text = expand(name, &[]).expect("imports resolve");
            reflect::validate(name, &text).unwrap_or_else(|error| panic!("{error}"));
        }
        // A shared file is a fragment, which is only valid where it is imported.
        let unused: Vec<_> = names().filter(|name| !used.contains(name)).collect();
        assert!(used.len() >= 3 && unused.is_empty(), "not imported: {unused:?}");
    }

    /// WebGPU's limits.
    const STORAGE_BUFFERS: usize = 8;
    const WORKGROUP_BYTES: u32 = 16 << 10;
    const INVOCATIONS: u32 = 256;

    /// What a kernel demands beyond the limits that every adapter has.
    fn demands(found: &reflect::Reflection) -> Vec<String> {
        let is_storage =
            |binding: &&reflect::ReflectedBinding| binding.access != reflect::Access::Uniform;
        let buffers = found.bindings.iter().filter(is_storage).count();
        let invocations: u32 = found.workgroup.iter().product();
        let bytes = found.workgroup_bytes;
        let faults = [
            (buffers > STORAGE_BUFFERS).then(|| format!("{buffers} storage buffers")),
            (bytes > WORKGROUP_BYTES).then(|| format!("{bytes} bytes of workgroup memory")),
            (invocations > INVOCATIONS).then(|| format!("{invocations} invocations")),
        ];
        faults.into_iter().flatten().collect()
    }

    #[test]
    fn every_kernel_runs_on_every_adapter_or_has_one_beside_it_that_does() {
        let mut with_subgroups = Vec::new();
        for name in names().filter(|name| !name.starts_with("shared/")) {
            let text = expand(name, &[]).expect("expands");
            let found = reflect::reflect(name, &text).expect("valid");
            assert_eq!(demands(&found), [""; 0], "{name}");
            if found.uses_subgroups {
                assert!(source(&format!("{name}_generic")).is_ok(), "{name} has no other");
                with_subgroups.push(name);
            }
        }
        assert_eq!(with_subgroups, ["splat/rasterize_backward"]);
    }

    #[test]
    fn a_kernel_that_demands_more_is_found() {
        let buffers: String = (0..9)
            .map(|n| format!("@group(0) @binding({n}) var<storage> b{n}: array<u32>;\n"))
            .collect();
        let text = format!(
            "{buffers}var<workgroup> shared_words: array<u32, 5000>;\n\
             @compute @workgroup_size(257) fn main() {{ shared_words[0] = 1u; }}"
        );
        let found = reflect::reflect("greedy", &text).expect("valid");
        let expected = ["9 storage buffers", "20000 bytes of workgroup memory", "257 invocations"];
        assert_eq!(demands(&found), expected);
    }

    #[test]
    fn a_shader_with_a_type_error_fails_validation() {
        let error =
            reflect::validate("bad", "fn f() -> f32 { return 1u; }").expect_err("a u32 is no f32");
        assert!(matches!(error, GpuError::Shader { name, .. } if name == "bad"));
    }

    #[test]
    fn an_import_reached_twice_is_inserted_once() {
        let text = expand("shared/test_axpy", &[]).expect("expands");
        assert_eq!(text.matches("fn flat_workgroup").count(), 1);
        assert!(!text.contains("#import"));
    }

    #[test]
    fn a_constant_is_replaced_and_an_unknown_one_is_refused() {
        let text = expand("shared/test_axpy", &[("ADD", 7)]).expect("expands");
        assert!(text.contains("const ADD: u32 = 7;"));
        assert!(matches!(expand("shared/test_axpy", &[("AD", 7)]), Err(GpuError::Shader { .. })));
        assert!(matches!(expand("shared/nothing", &[]), Err(GpuError::Shader { .. })));
    }
}
