//! Cleanup of partially written files. They are named after the host and the process that writes
//! them (`.incise-HOST-PID-RANDOM.part`), registered in that process, and removed when they are
//! dropped, when the process receives a termination signal (INT, TERM, HUP), or, after a crash, by
//! the next write into the same folder.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const PREFIX: &str = ".incise-";
const SUFFIX: &str = ".part";
/// A file modified within this time is never treated as a leftover.
const FRESH: Duration = Duration::from_secs(60);
/// A file of another machine, whose processes cannot be queried, is a leftover after this time.
const OLD: Duration = Duration::from_secs(7 * 24 * 3600);

static UNFINISHED: LazyLock<Mutex<HashSet<PathBuf>>> = LazyLock::new(Mutex::default);

fn unfinished() -> MutexGuard<'static, HashSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// This machine's name, reduced to letters and digits.
static HOST: LazyLock<String> = LazyLock::new(|| {
    #[cfg(unix)]
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    #[cfg(not(unix))]
    let name = std::env::var("COMPUTERNAME").unwrap_or_default();
    name.chars()
        .filter(char::is_ascii_alphanumeric)
        .take(32)
        .collect()
});

fn builder(prefix: &str) -> tempfile::Builder<'_, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix).suffix(SUFFIX);
    builder
}

fn own_prefix() -> String {
    format!("{PREFIX}{}-{}-", *HOST, std::process::id())
}

/// An unfinished file.
pub struct PartFile {
    file: Option<tempfile::NamedTempFile>,
    path: PathBuf,
}

impl PartFile {
    /// Creates one in a folder, after removing the leftovers of dead processes there.
    ///
    /// # Errors
    /// Errors from the operating system.
    pub fn in_folder(folder: &Path) -> std::io::Result<Self> {
        remove_stale(folder);
        let prefix = own_prefix();
        let mut builder = builder(&prefix);
        #[cfg(unix)]
        {
            // The mode of any new file, before the umask.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        // Registered before a signal can end the process.
        let mut registered = unfinished();
        let file = builder.tempfile_in(folder)?;
        let path = file.path().to_owned();
        registered.insert(path.clone());
        Ok(Self {
            file: Some(file),
            path,
        })
    }

    /// The file, for writing.
    ///
    /// # Errors
    /// None before the file has been moved into place.
    pub fn file(&mut self) -> std::io::Result<&mut std::fs::File> {
        self.file
            .as_mut()
            .map(tempfile::NamedTempFile::as_file_mut)
            .ok_or_else(|| std::io::ErrorKind::NotFound.into())
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves it to its destination, replacing an existing file.
    ///
    /// # Errors
    /// Errors from the operating system; the file is removed.
    pub fn persist(mut self, to: &Path) -> std::io::Result<()> {
        match self.file.take() {
            Some(file) => file.persist(to).map(drop).map_err(|e| e.error),
            None => Ok(()),
        }
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        drop(self.file.take());
        unfinished().remove(&self.path);
    }
}

/// An unfinished folder.
pub struct PartFolder {
    folder: Option<tempfile::TempDir>,
    path: PathBuf,
}

impl PartFolder {
    /// Creates one in a folder, after removing the leftovers of dead processes there.
    ///
    /// # Errors
    /// Errors from the operating system.
    pub fn in_folder(folder: &Path) -> std::io::Result<Self> {
        remove_stale(folder);
        let prefix = own_prefix();
        let mut registered = unfinished();
        let made = builder(&prefix).tempdir_in(folder)?;
        let path = made.path().to_owned();
        registered.insert(path.clone());
        Ok(Self {
            folder: Some(made),
            path,
        })
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Renames it to its final name, replacing an empty folder.
    ///
    /// # Errors
    /// Errors from the operating system; the folder is removed.
    pub fn persist(mut self, to: &Path) -> std::io::Result<()> {
        if to.is_dir() {
            // Not every system can replace an empty folder by renaming.
            std::fs::remove_dir(to)?;
        }
        std::fs::rename(&self.path, to)?;
        if let Some(folder) = self.folder.take() {
            // It has been renamed: there is nothing left to remove.
            let _ = folder.keep();
        }
        Ok(())
    }
}

impl Drop for PartFolder {
    fn drop(&mut self) {
        drop(self.folder.take());
        unfinished().remove(&self.path);
    }
}

fn remove(path: &Path) {
    // It may already be gone, and a failure to remove it cannot be handled.
    let _gone = if path.is_dir() {
        std::fs::remove_dir_all(path)
    } else {
        std::fs::remove_file(path)
    };
}

/// Removes the leftovers of dead processes in a folder.
fn remove_stale(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let Some(name) = name
            .to_str()
            .and_then(|n| n.strip_prefix(PREFIX)?.strip_suffix(SUFFIX))
        else {
            continue;
        };
        let age = entry
            .metadata()
            .and_then(|m| m.modified())
            .ok()
            .and_then(|t| t.elapsed().ok())
            .unwrap_or_default();
        if is_stale(name, age) {
            remove(&entry.path());
        }
    }
}

/// Whether a leftover with this name (without the common prefix and suffix) is abandoned.
fn is_stale(name: &str, age: Duration) -> bool {
    if age < FRESH {
        return false;
    }
    let mut parts = name.split('-');
    match (parts.next(), parts.next().and_then(|p| p.parse::<u32>().ok())) {
        (Some(host), Some(process)) if host == *HOST => !is_alive(process),
        _ => age > OLD,
    }
}

/// Whether a process of this machine is running; assumed so if it cannot be determined.
fn is_alive(process: u32) -> bool {
    #[cfg(unix)]
    {
        let Some(process) = i32::try_from(process)
            .ok()
            .and_then(rustix::process::Pid::from_raw)
        else {
            return false;
        };
        // A process of another user cannot be signalled, but is alive.
        !matches!(
            rustix::process::test_kill_process(process),
            Err(rustix::io::Errno::SRCH)
        )
    }
    #[cfg(not(unix))]
    {
        let _ = process;
        true
    }
}

/// Removes the unfinished files of this process, which is about to exit.
pub fn remove_all() {
    // The lock may be held by the code that failed.
    if let Ok(registered) = UNFINISHED.try_lock() {
        registered.iter().for_each(|path| remove(path));
    }
}

/// Removes unfinished files when the process receives a termination signal. A program calls this
/// once, before it starts threads that write. Signals that the process was started to ignore
/// (`nohup`) stay ignored.
pub fn remove_on_signals() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        let ignored = ignored_signals();
        let heeded = [SIGINT, SIGTERM, SIGHUP]
            .into_iter()
            .filter(|s| ignored & (1 << (s - 1)) == 0);
        let Ok(mut signals) = signal_hook::iterator::Signals::new(heeded) else {
            return;
        };
        let waiting = std::thread::Builder::new().name("signals".into()).spawn(move || {
            if let Some(signal) = signals.forever().next() {
                // Held until exit, so that no new file is created.
                let registered = unfinished();
                registered.iter().for_each(|path| remove(path));
                let _ended = signal_hook::low_level::emulate_default_handler(signal);
                std::process::exit(128 + signal);
            }
        });
        // If the thread could not be started, the next write removes the leftovers.
        drop(waiting);
    }
}

/// The signals that this process ignores, one bit each, where the system reports them (Linux).
#[cfg(unix)]
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok())
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn left_overs_of_the_dead_are_removed_and_those_of_the_living_are_not() {
        let own = std::process::id();
        let (minute, month) = (Duration::from_secs(120), Duration::from_secs(31 * 24 * 3600));
        // No process has this id: the largest is 2^22.
        let dead = 1u32 << 30;
        for (name, age, stale) in [
            (format!("{}-{dead}-abc", *HOST), minute, true),
            (format!("{}-{dead}-abc", *HOST), Duration::ZERO, false),
            (format!("{}-{own}-abc", *HOST), month, false),
            (format!("elsewhere-{dead}-abc"), minute, false),
            (format!("elsewhere-{dead}-abc"), month, true),
            ("Ab12Cd".into(), month, true),
        ] {
            assert_eq!(is_stale(&name, age), stale, "{name} {age:?}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn the_next_write_clears_up() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let at = |name: String| folder.path().join(name);
        let (dead, fresh, other) = (
            at(format!("{PREFIX}{}-{}-x{SUFFIX}", *HOST, 1 << 30)),
            at(format!("{PREFIX}{}-{}-y{SUFFIX}", *HOST, 1 << 30)),
            at("notes.part".into()),
        );
        for path in [&dead, &fresh, &other] {
            std::fs::write(path, "x").unwrap_or_else(|e| panic!("{e}"));
        }
        let long_ago = std::time::SystemTime::now() - Duration::from_secs(3600);
        for path in [&dead, &other] {
            std::fs::File::options()
                .write(true)
                .open(path)
                .and_then(|f| f.set_modified(long_ago))
                .unwrap_or_else(|e| panic!("{e}"));
        }
        let part = PartFile::in_folder(folder.path()).unwrap_or_else(|e| panic!("{e}"));
        assert!(!dead.exists() && fresh.exists() && other.exists() && part.path().exists());
        let path = part.path().to_owned();
        assert!(unfinished().contains(&path));
        drop(part);
        assert!(!path.exists() && !unfinished().contains(&path));
    }
}
