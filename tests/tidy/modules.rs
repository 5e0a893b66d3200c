//! Which file uses which: every path is followed, through imports and re-exports, to the file
//! that defines what it names.

use std::collections::BTreeMap;

use crate::imports::{Outline, Path};
use crate::sources::Source;

/// More re-exports in a row than anybody writes. A name that leads to itself is another crate's.
const LONGEST_CHAIN: usize = 16;

/// A file that uses an item of another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Edge {
    /// The file that uses.
    pub from: String,
    /// The file that defines.
    pub to: String,
    /// What it uses.
    pub name: String,
    /// Where it does so first.
    pub line: usize,
}

/// The modules that have a file of their own, tests left out, by path: the file of the crate, then
/// the names.
pub struct Modules(BTreeMap<Vec<String>, Module>);

struct Module {
    file: String,
    outline: Outline,
}

/// What a path leads to.
enum Target {
    Module(Vec<String>),
    /// An item with its name, and the module of the file that defines it.
    Item(Vec<String>, String),
}

/// What a name stands for, where it may be a module or an item.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sought {
    Module,
    Item,
}

/// What a module calls by some name.
enum Found<'a> {
    Child(Vec<String>),
    Import(&'a Path),
}

impl Modules {
    /// Every file that the `mod` lines of a `lib.rs` or `main.rs` lead to.
    ///
    /// # Panics
    /// Where a `mod` line leads to no file.
    pub fn of(sources: &[Source]) -> Self {
        let by_path = sources.iter().map(|source| (source.path.as_str(), source));
        let by_path: BTreeMap<&str, &Source> = by_path.collect();
        let mut modules = Self(BTreeMap::new());
        for root in by_path.keys() {
            if let Some((folder, "lib.rs" | "main.rs")) = root.rsplit_once('/') {
                modules.add(vec![(*root).to_owned()], root, folder, &by_path);
            }
        }
        modules
    }

    /// Adds a module and those below it, whose files lie in `folder`.
    fn add(
        &mut self,
        module: Vec<String>,
        file: &str,
        folder: &str,
        sources: &BTreeMap<&str, &Source>,
    ) {
        let outline = Outline::of(sources[file]);
        for child in &outline.children {
            let folder = format!("{folder}/{}", child.join("/"));
            let files = [format!("{folder}.rs"), format!("{folder}/mod.rs")];
            let file = files
                .iter()
                .find(|file| sources.contains_key(file.as_str()));
            let file =
                file.unwrap_or_else(|| panic!("`mod` in {module:?} without a file: {files:?}"));
            let module = [&module[..], child].concat();
            self.add(module, file, &folder, sources);
        }
        let file = file.to_owned();
        self.0.insert(module, Module { file, outline });
    }

    /// How many files there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Who uses whom, each item once, sorted.
    pub fn edges(&self) -> Vec<Edge> {
        let mut edges = Vec::new();
        for (module, Module { outline, .. }) in &self.0 {
            for import in &outline.imports {
                let target = self.target(module, &import.path, Sought::Module, 0);
                // A module that shows its child's items to others does not use them.
                let below = matches!(&target, Some(Target::Item(child, _))
                    if child.starts_with(module));
                if !(import.exported && below) {
                    edges.extend(self.edge(module, &import.path, target));
                }
            }
            for path in &outline.paths {
                edges.extend(self.edge(module, path, self.target(module, path, Sought::Item, 0)));
            }
        }
        edges.sort();
        edges.dedup_by(|next, first| {
            (&next.from, &next.to, &next.name) == (&first.from, &first.to, &first.name)
        });
        edges
    }

    fn edge(&self, module: &[String], path: &Path, target: Option<Target>) -> Option<Edge> {
        match target? {
            Target::Item(owner, name) if owner != module => Some(Edge {
                from: self.0[module].file.clone(),
                to: self.0[&owner].file.clone(),
                name,
                line: path.line,
            }),
            _ => None,
        }
    }

    /// What a path in the file of `module` leads to, where that is in the same crate.
    fn target(
        &self,
        module: &[String],
        path: &Path,
        sought: Sought,
        chain: usize,
    ) -> Option<Target> {
        let mut at = [module, &path.inside].concat();
        let mut segments = &path.segments[..];
        while let [first, rest @ ..] = segments
            && matches!(first.as_str(), "crate" | "self" | "super")
        {
            match first.as_str() {
                "crate" => at.truncate(1),
                "super" => at.truncate(at.len().checked_sub(1)?),
                _ => {}
            }
            segments = rest;
        }
        if segments.len() < path.segments.len() {
            return self.walk(at, segments, sought, chain);
        }
        // What is neither a child nor imported is of this file, or another crate.
        let (first, rest) = segments.split_first()?;
        let sought_first = if rest.is_empty() {
            sought
        } else {
            Sought::Module
        };
        let found = self.found(&at, first, sought_first)?;
        match self.follow(&at, found, sought_first, chain)? {
            Target::Module(at) => self.walk(at, rest, sought, chain),
            item => Some(item),
        }
    }

    /// Where the segments lead from a module.
    fn walk(
        &self,
        mut at: Vec<String>,
        segments: &[String],
        sought: Sought,
        chain: usize,
    ) -> Option<Target> {
        for (left, segment) in (0..segments.len()).rev().zip(segments) {
            let sought = if left == 0 { sought } else { Sought::Module };
            let target = match self.found(&at, segment, sought) {
                Some(found) => self.follow(&at, found, sought, chain)?,
                None => Target::Item(self.owner(&at)?, segment.clone()),
            };
            match target {
                Target::Module(below) => at = below,
                item => return Some(item),
            }
        }
        Some(Target::Module(at))
    }

    fn follow(
        &self,
        at: &[String],
        found: Found<'_>,
        sought: Sought,
        chain: usize,
    ) -> Option<Target> {
        match found {
            Found::Child(child) => Some(Target::Module(child)),
            Found::Import(_) if chain == LONGEST_CHAIN => None,
            Found::Import(path) => self.target(&self.owner(at)?, path, sought, chain + 1),
        }
    }

    /// What a module calls by this name: a child may share its name with an imported item.
    fn found(&self, at: &[String], name: &str, sought: Sought) -> Option<Found<'_>> {
        let child = [at, &[name.to_owned()]].concat();
        let import = self.import(at, name);
        match import {
            Some(import) if sought == Sought::Item => Some(Found::Import(import)),
            _ if self.0.contains_key(&child) => Some(Found::Child(child)),
            import => import.map(Found::Import),
        }
    }

    fn import(&self, at: &[String], name: &str) -> Option<&Path> {
        let owner = self.owner(at)?;
        let mut imports = self.0[&owner].outline.imports.iter();
        let found =
            imports.find(|import| import.name == name && import.path.inside == at[owner.len()..]);
        found.map(|import| &import.path)
    }

    /// The module with a file of its own that a module is, or lies in.
    fn owner(&self, at: &[String]) -> Option<Vec<String>> {
        let mut lengths = (1..=at.len()).rev();
        let length = lengths.find(|length| self.0.contains_key(&at[..*length]))?;
        Some(at[..length].to_vec())
    }
}
