//! Matches a file's names to photographs. Nothing is guessed: a name that matches two photographs,
//! or two names that match one, are an error.

use std::collections::{BTreeMap, HashSet};

use super::PhotoPath;

/// Names and photographs whose match is ambiguous.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", message(names, photographs))]
pub struct Tie {
    /// As written in the file.
    pub names: Vec<PhotoPath>,
    /// The photographs that they may refer to.
    pub photographs: Vec<PhotoPath>,
}

fn message(names: &[PhotoPath], photographs: &[PhotoPath]) -> String {
    let all = |paths: &[PhotoPath]| {
        let shown: Vec<_> = paths.iter().take(3).map(|path| format!("`{path}`")).collect();
        let more = if paths.len() > 3 { " and others" } else { "" };
        format!("{}{more}", shown.join(" and "))
    };
    let is_same = |paths: &[PhotoPath]| paths.windows(2).all(|pair| pair[0] == pair[1]);
    match (names.len(), photographs.len()) {
        (count, _) if count > 1 && is_same(names) => {
            format!("`{}` has {count} different poses", names[0])
        }
        (1, count) if is_same(photographs) => format!(
            "{} may be any of {count} photographs of this name: give each its folder too, as in \
             `cam0/{}`",
            all(names),
            names[0].name()
        ),
        (1, _) => format!(
            "{} may be any of {}: write the names with their folders and extensions",
            all(names),
            all(photographs)
        ),
        _ => format!(
            "{} may all be {}: name the photographs as the poses do, folders included",
            all(names),
            all(photographs)
        ),
    }
}

/// For each photograph the index of its name. Each step requires less to agree: the whole path; all
/// folders of the shorter of the two, the longest first; if no name was found this way, at least
/// the last part. In each step the case, then the extension may differ. Folders that no other pair
/// ignores are ignored only if the name is unique.
///
/// # Errors
/// [`Tie`].
pub fn find_each(
    names: &[PhotoPath],
    photographs: &[PhotoPath],
) -> Result<Vec<Option<usize>>, Tie> {
    let mut lookup = Lookup {
        names,
        photographs,
        name_is_found: vec![false; names.len()],
        found: vec![None; photographs.len()],
        left_out: HashSet::new(),
    };
    for loosely in LOOSER {
        lookup.step(loosely, usize::MAX, Folders::All)?;
    }
    let deepest = |paths: &[PhotoPath]| paths.iter().map(depth).max().unwrap_or(0);
    let longest = deepest(names).min(deepest(photographs)).min(MOST_PARTS);
    for parts in (1..=longest).rev() {
        for loosely in LOOSER {
            lookup.step(loosely, parts, Folders::OfTheShorter)?;
        }
    }
    for parts in (1..=longest).rev() {
        // The same photographs may be in a renamed folder; but if folders did agree, a different
        // folder is another one.
        if lookup.found.iter().any(Option::is_some) {
            break;
        }
        for loosely in LOOSER {
            lookup.step(loosely, parts, Folders::Any)?;
        }
    }
    Ok(lookup.found)
}

/// Deeper folders count only as a whole: the input is untrusted.
const MOST_PARTS: usize = 16;

fn depth(path: &PhotoPath) -> usize {
    path.as_str().split('/').count()
}

/// Allowed differences between a name and its photograph.
#[derive(Clone, Copy)]
struct Loosely {
    /// Whether to ignore the extension: of the name, of the photograph.
    extension: [bool; 2],
    case: bool,
}

const fn loosely(extension: [bool; 2], case: bool) -> Loosely {
    Loosely { extension, case }
}

/// From the strictest on. Only one side may have an extension, as in NeRF.
const LOOSER: [Loosely; 8] = [
    loosely([false, false], false),
    loosely([false, false], true),
    loosely([false, true], false),
    loosely([true, false], false),
    loosely([true, true], false),
    loosely([false, true], true),
    loosely([true, false], true),
    loosely([true, true], true),
];

/// Which of the folders before the last parts must agree.
#[derive(Clone, Copy, PartialEq)]
enum Folders {
    All,
    OfTheShorter,
    Any,
}

struct Lookup<'a> {
    names: &'a [PhotoPath],
    photographs: &'a [PhotoPath],
    name_is_found: Vec<bool>,
    found: Vec<Option<usize>>,
    /// The folders ignored in matched names and photographs.
    left_out: HashSet<[&'a str; 2]>,
}

/// Names and photographs whose last parts are equal.
#[derive(Default)]
struct Group {
    names: Vec<usize>,
    photographs: Vec<usize>,
    /// Whether there are others that are already matched.
    has_found: bool,
}

impl<'a> Lookup<'a> {
    /// Matches what remains: this many last parts must be equal.
    fn step(&mut self, loosely: Loosely, parts: usize, folders: Folders) -> Result<(), Tie> {
        let mut left_out = Vec::new();
        for group in self.groups(loosely, parts) {
            let group = self.that_may_mean_each_other(group, parts, folders);
            match (&group.names[..], &group.photographs[..]) {
                ([], _) | (_, []) => {}
                ([name], [photograph]) => {
                    let pair = [&self.names[*name], &self.photographs[*photograph]];
                    let without = pair.map(|path| before(path, parts));
                    if folders != Folders::All
                        && group.has_found
                        && !self.left_out.contains(&without)
                    {
                        continue;
                    }
                    left_out.push(without);
                    self.name_is_found[*name] = true;
                    self.found[*photograph] = Some(*name);
                }
                _ => return Err(self.tie(&group)),
            }
        }
        self.left_out.extend(left_out);
        Ok(())
    }

    /// Names and photographs by their last parts, where both remain.
    fn groups(&self, loosely: Loosely, parts: usize) -> Vec<Group> {
        let [of_name, of_photograph] = loosely.extension;
        let mut groups: BTreeMap<String, Group> = BTreeMap::new();
        for (index, path) in self.photographs.iter().enumerate() {
            if let Some(key) = key(path, of_photograph, loosely.case, parts) {
                let group = groups.entry(key).or_default();
                match self.found[index] {
                    None => group.photographs.push(index),
                    Some(_) => group.has_found = true,
                }
            }
        }
        for (index, path) in self.names.iter().enumerate() {
            if let Some(key) = key(path, of_name, loosely.case, parts)
                && let Some(group) = groups.get_mut(&key)
            {
                match self.name_is_found[index] {
                    false => group.names.push(index),
                    true => group.has_found = true,
                }
            }
        }
        groups.into_values().collect()
    }

    /// Removes those whose folders differ from all on the other side.
    fn that_may_mean_each_other(&self, group: Group, parts: usize, folders: Folders) -> Group {
        if folders != Folders::OfTheShorter {
            return group;
        }
        let is_short = |path: &PhotoPath| depth(path) == parts;
        let short_name = group.names.iter().any(|&at| is_short(&self.names[at]));
        let short_photograph = group.photographs.iter();
        let short_photograph = { short_photograph }.any(|&at| is_short(&self.photographs[at]));
        let mut group = group;
        let (names, photographs) = (&mut group.names, &mut group.photographs);
        names.retain(|&at| short_photograph || is_short(&self.names[at]));
        photographs.retain(|&at| short_name || is_short(&self.photographs[at]));
        group
    }

    fn tie(&self, group: &Group) -> Tie {
        let of = |all: &[PhotoPath], indices: &[usize]| {
            indices.iter().map(|&index| all[index].clone()).collect()
        };
        Tie {
            names: of(self.names, &group.names),
            photographs: of(self.photographs, &group.photographs),
        }
    }
}

/// The path without this many last parts.
fn before(path: &PhotoPath, parts: usize) -> &str {
    let cut = path.as_str().rmatch_indices('/').nth(parts.saturating_sub(1));
    cut.map_or("", |(at, _)| &path.as_str()[..at])
}

/// The last parts of a path, all of them if `parts` is the maximum; `None` if it has fewer, or no
/// extension to remove.
fn key(path: &PhotoPath, leave_out_extension: bool, fold: bool, parts: usize) -> Option<String> {
    let whole = path.as_str();
    let kept = if leave_out_extension {
        let extension = whole.rsplit_once('.').filter(|(_, end)| is_extension(end));
        extension?.0
    } else {
        whole
    };
    let mut key = kept;
    if parts != usize::MAX {
        let start = match kept.rmatch_indices('/').nth(parts - 1) {
            Some((at, _)) => at + 1,
            None if depth(path) == parts => 0,
            None => return None,
        };
        key = &kept[start..];
    }
    Some(if fold { key.to_lowercase() } else { key.to_owned() })
}

/// Whether the text after a dot is an extension rather than part of a number.
fn is_extension(end: &str) -> bool {
    (1..=5).contains(&end.len())
        && end.starts_with(|c: char| c.is_ascii_alphabetic())
        && end.bytes().all(|byte| byte.is_ascii_alphanumeric())
}
