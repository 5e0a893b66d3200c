//! Boundaries between the crates, which keep dependencies one-way.

use crate::sources::{Source, expect_none, files};

/// Words that some files must not use.
struct Boundary {
    /// Folders or files of the rule.
    within: &'static [&'static str],
    /// Exceptions among them.
    except: &'static [&'static str],
    /// The forbidden words, as whole words.
    words: &'static [&'static str],
    reason: &'static str,
}

const BOUNDARIES: [Boundary; 9] = [
    Boundary {
        within: &["src/", "tests/"],
        except: &["src/gpu/", "tests/tidy/"],
        words: &["wgpu"],
        reason: "only fled-gpu knows wgpu",
    },
    Boundary {
        within: &["src/capture/", "src/core/", "src/lab/", "src/gpu/"],
        except: &[],
        words: &["axum", "sqlx", "tokio", "hyper", "tower", "clap", "reqwest", "ureq", "rusqlite"],
        reason: "the core has no HTTP, no SQL, no async runtime and no command line",
    },
    Boundary {
        within: &["src/"],
        except: &["src/capture/group/unix.rs"],
        words: &["process_group", "kill_process_group", "kill_on_drop"],
        reason: "there is one way to run a child process",
    },
    Boundary {
        within: &["src/capture/", "src/core/", "src/lab/"],
        except: &[],
        words: &["env::var", "env::var_os", "env::vars", "env::set_var"],
        reason: "the core takes what it needs as arguments",
    },
    Boundary {
        within: &["src/core/", "src/lab/"],
        except: &["src/core/inference/", "src/core/deblur/onnx", "src/core/Cargo.toml"],
        words: &["ort"],
        reason: "only inference and the deblurring network know ONNX Runtime",
    },
    Boundary {
        within: &["src/core/"],
        except: &[],
        words: &["flashraw", "heifer", "moxcms", "tiff"],
        reason: "only fled-capture decodes photographs",
    },
    Boundary {
        within: &["src/capture/"],
        except: &[],
        words: &["fled_core", "Gaussians", "ort"],
        reason: "fled-capture knows files, not what is made of them",
    },
    Boundary {
        within: &["src/gpu/"],
        except: &[],
        words: &["Gaussian", "Gaussians", "Splat", "fled_core"],
        reason: "fled-gpu knows buffers and kernels, not splats",
    },
    Boundary {
        within: &["src/server/"],
        except: &[
            "src/server/http",
            "src/server/serve.rs",
            "src/server/fake/",
            "src/server/Cargo.toml",
        ],
        words: &["axum"],
        reason: "jobs, captures and their store know no shape of the API",
    },
];

/// The modules of the server. Each uses only those before it.
const SERVER: [&str; 23] = [
    "error",
    "failpoint",
    "token",
    "redaction",
    "telemetry",
    "rate",
    "store",
    "config",
    "process",
    "files",
    "memory",
    "validation",
    "validator",
    "render",
    "app",
    "sharing",
    "sample",
    "worker",
    "janitor",
    "webhooks",
    "transfer",
    "http",
    "serve",
];

/// Uses of a module of the server by one before it.
fn upward(source: &Source) -> Vec<String> {
    let Some(path) = source.path.strip_prefix("src/server/") else {
        return Vec::new();
    };
    let level = |name: &str| SERVER.iter().position(|module| *module == name);
    let module = path.split(['/', '.']).next().unwrap_or_default();
    let Some(own) = level(module) else {
        let is_outside = ["lib", "fake", "tests", "Cargo"].contains(&module);
        let fault = format!("{}: no level in the order of the server", source.path);
        return if is_outside { Vec::new() } else { vec![fault] };
    };
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let mut faults = Vec::new();
    for (number, line) in source.code() {
        for used in line.split("crate::").skip(1) {
            let used = used.split(|c| !is_part(c)).next().unwrap_or_default();
            if level(used).is_some_and(|level| level > own) {
                let place = format!("{}:{number}", source.path);
                faults.push(format!("{place}: {module} may not use {used}, which is above it"));
            }
        }
    }
    faults
}

fn faults(sources: &[Source]) -> Vec<String> {
    let mut faults: Vec<String> = sources.iter().flat_map(upward).collect();
    for boundary in &BOUNDARIES {
        let concerns = |path: &str| {
            boundary.within.iter().any(|start| path.starts_with(start))
                && !boundary.except.iter().any(|start| path.starts_with(start))
        };
        for source in sources.iter().filter(|source| concerns(&source.path)) {
            for (number, line) in source.code() {
                let named = boundary.words.iter().filter(|word| names(line, word));
                faults.extend(named.map(|word| {
                    format!("{}:{number}: `{word}`: {}", source.path, boundary.reason)
                }));
            }
        }
    }
    faults
}

/// Whether a line of code contains a word, not as a part of a longer one or in a string.
fn names(line: &str, word: &str) -> bool {
    let code: String = line.split('"').step_by(2).collect::<Vec<_>>().join("\"\"");
    let part = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(word)
        .any(|(at, _)| !code[..at].ends_with(part) && !code[at + word.len()..].starts_with(part))
}

#[test]
fn no_crate_uses_words_of_another() {
    let mut sources = files("src", "rs");
    sources.extend(files("tests", "rs"));
    sources.extend(files("src", "toml"));
    sources.extend(files("tests", "toml"));
    expect_none(&faults(&sources));
}

#[test]
fn a_forbidden_word_is_detected() {
    for (path, line) in [
        ("src/core/splat.rs", "use wgpu::Buffer;"),
        ("src/core/Cargo.toml", "wgpu.workspace = true"),
        ("src/core/colmap.rs", "let home = std::env::var(\"HOME\");"),
        ("src/core/Cargo.toml", "tokio = \"1\""),
        ("src/core/enhance.rs", "use ort::session::Session;"),
        ("src/core/exposure.rs", "let header = heifer::read(bytes);"),
        ("src/capture/mask.rs", "use fled_core::render::Renderer;"),
        ("src/gpu/buffer.rs", "fn upload(scene: &Gaussians) {}"),
        ("src/server/worker.rs", "use crate::http::Verdict;"),
        ("src/server/unknown.rs", "fn free() {}"),
        ("src/server/store/jobs.rs", "let limits = crate::config::Limits::default();"),
    ] {
        assert_eq!(faults(&[Source::made_up(path, line)]).len(), 1, "{path}: {line}");
    }
}

#[test]
fn comments_strings_and_longer_words_are_allowed() {
    let text = "// wgpu is elsewhere\nlet sort = export(\"wgpu\");\nlet wgpu_free = 1;\n";
    expect_none(&faults(&[Source::made_up("src/core/splat.rs", text)]));
}
