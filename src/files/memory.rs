//! Available memory. The system overcommits memory and kills the process that uses it; checking
//! first allows an error message instead.

use crate::{Error, Result};
use std::path::Path;

/// Bytes that the process can still allocate, where the system reports it (Linux): the available
/// memory of the machine or of the control group, whichever is less.
pub fn available_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("MemAvailable:"))?;
    let machine = line
        .split_whitespace()
        .nth(1)?
        .parse::<u64>()
        .ok()?
        .checked_mul(1024)?;
    let available = control_group_bytes().map_or(machine, |group| group.min(machine));
    // A part is left for other processes.
    Some(available - available / 16)
}

/// Memory left within the limit of this process's control group (version 2); none without a limit.
fn control_group_bytes() -> Option<u64> {
    let group = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let name = group.lines().find_map(|l| l.strip_prefix("0::"))?;
    let folder = Path::new("/sys/fs/cgroup").join(name.trim_start_matches('/'));
    let number = |file: &str| {
        std::fs::read_to_string(folder.join(file))
            .ok()?
            .trim()
            .parse::<u64>()
            .ok()
    };
    // Cached pages of files count as used, but are reclaimed at once.
    let cached = std::fs::read_to_string(folder.join("memory.stat"))
        .ok()
        .and_then(|s| {
            s.lines()
                .find_map(|l| l.strip_prefix("inactive_file "))?
                .parse::<u64>()
                .ok()
        });
    Some(number("memory.max")?.saturating_sub(number("memory.current")?.saturating_sub(cached.unwrap_or(0))))
}

/// The process's peak resident size, where the system reports it (Linux).
pub fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace()
        .nth(1)?
        .parse::<u64>()
        .ok()
        .map(|kib| kib * 1024)
}

/// Returns an error if more memory is needed than is available.
///
/// # Errors
/// `path` needs `bytes`, and there are fewer.
pub fn check(path: &Path, bytes: u64) -> Result<()> {
    match available_bytes() {
        // Refused only if the available memory is known.
        Some(available) if bytes > available => Err(too_large(path, bytes, Some(available))),
        _ => Ok(()),
    }
}

fn too_large(path: &Path, bytes: u64, available: Option<u64>) -> Error {
    let mib = |b: u64| b.div_ceil(1 << 20);
    let there = available.map_or_else(
        || "more than is available".to_owned(),
        |a| format!("but only {} MiB are available", mib(a)),
    );
    Error::file(
        path,
        format!(
            "needs {} MiB of memory, {there}; close other programs or use a downsampled copy",
            mib(bytes)
        ),
    )
}

/// Capacity for `count` values, reserved with an error instead of an abort.
///
/// # Errors
/// There is not enough memory; the error names `path`.
pub fn reserve<T>(path: &Path, count: usize) -> Result<Vec<T>> {
    let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
    if bytes > 1 << 24 {
        check(path, bytes)?;
    }
    let mut values = Vec::new();
    values
        .try_reserve_exact(count)
        .map_err(|_| too_large(path, bytes, None))?;
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_there_is_not_is_refused() {
        let error = reserve::<u64>(Path::new("huge.raw"), 1 << 50)
            .err()
            .map(|e| e.to_string())
            .unwrap_or_default();
        assert!(error.starts_with("huge.raw: needs 8589934592 MiB"), "{error}");
        assert!(reserve::<u64>(Path::new("small.raw"), 1 << 20).is_ok_and(|v| v.capacity() >= 1 << 20));
        #[cfg(target_os = "linux")]
        assert!(available_bytes().is_some_and(|b| b > 1 << 20));
    }
}
