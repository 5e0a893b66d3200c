//! Whether memory ran out: how many processes the kernel has ended for that reason.

use std::fs;
use std::io;
use std::path::Path;

use crate::files::data::write_atomically;

/// Processes ended for lack of memory in the control group of this process, or without one on the
/// whole machine; `None` if the kernel does not say.
pub fn kills() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = groups.lines().find_map(|line| line.strip_prefix("0::"));
    let events = group.map(|group| format!("/sys/fs/cgroup{group}/memory.events"));
    let events = events.and_then(|path| fs::read_to_string(path).ok());
    events.and_then(|text| number(&text)).or_else(kills_of_machine)
}

/// The same count for the whole machine since it booted; a new control group starts at zero.
fn kills_of_machine() -> Option<u64> {
    number(&fs::read_to_string("/proc/vmstat").ok()?)
}

/// The counter in a file of lines `name number`.
fn number(text: &str) -> Option<u64> {
    text.lines().find_map(|line| line.strip_prefix("oom_kill ")?.trim().parse().ok())
}

/// Writes the present count to a file, for a later process.
///
/// # Errors
/// When the file cannot be written.
pub fn note(path: &Path) -> io::Result<()> {
    match present() {
        Some(count) if fs::read_to_string(path).ok().as_ref() != Some(&count) => {
            write_atomically(path, count.as_bytes())
        }
        _ => Ok(()),
    }
}

/// Returns whether memory ran out since the note in this file; no, if nothing shows it.
pub fn ran_out_since(path: &Path) -> bool {
    let noted = fs::read_to_string(path).ok();
    noted.zip(present()).is_some_and(|(noted, now)| has_risen(&noted, &now))
}

/// The machine's start and its count, on two lines.
fn present() -> Option<String> {
    let start = fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    Some(format!("{}\n{}\n", start.trim(), kills_of_machine()?))
}

/// Whether the count has risen since an earlier note of the same start of the machine.
fn has_risen(noted: &str, now: &str) -> bool {
    let read = |text: &str| {
        let (start, count) = text.trim().split_once('\n')?;
        Some((start.to_owned(), count.parse::<u64>().ok()?))
    };
    match (read(noted), read(now)) {
        (Some((then, before)), Some((start, count))) => then == start && count > before,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_higher_count_since_the_same_start_shows_that_memory_ran_out() {
        assert!(has_risen("a\n3\n", "a\n4\n"));
        assert!(!has_risen("a\n3\n", "a\n3\n"));
        assert!(!has_risen("a\n3\n", "b\n4\n"), "the machine was started again");
        assert!(!has_risen("", "a\n4\n") && !has_risen("a\nx\n", "a\n4\n"));
    }

    #[test]
    fn the_kernels_files_are_read() {
        let events = "low 0\nhigh 0\nmax 7\noom 2\noom_kill 1\noom_group_kill 0\n";
        assert_eq!(number(events), Some(1));
        assert_eq!(number("nr_free_pages 5\noom_kill 12\n"), Some(12));
        assert_eq!(number("oom 2\n"), None);
    }

    #[test]
    fn a_note_shows_nothing_by_itself() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("oom_kills");
        assert!(!ran_out_since(&path), "no note");
        note(&path).expect("written");
        assert!(!ran_out_since(&path));
    }
}
