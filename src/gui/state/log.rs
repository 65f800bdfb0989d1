//! Messages of the program: a persistent list, and toasts for new messages.

use std::time::SystemTime;

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    /// Information.
    Info,
    /// A request was carried out differently than requested.
    Warning,
    /// A request failed.
    Error,
}

/// One message.
#[derive(Clone, Debug)]
pub struct LogEntry {
    /// Severity.
    pub level: LogLevel,
    /// Text.
    pub text: String,
    /// Time.
    pub at: SystemTime,
    /// Number of consecutive occurrences.
    pub times: usize,
}

/// Messages, oldest first.
#[derive(Default)]
pub struct Log {
    entries: Vec<LogEntry>,
}

/// Most messages retained.
const MAX_MESSAGES: usize = 500;

impl Log {
    /// Adds a message; false if it repeats the last one.
    pub fn add(&mut self, level: LogLevel, text: impl Into<String>) -> bool {
        let text = text.into();
        if let Some(last) = self
            .entries
            .last_mut()
            .filter(|e| e.text == text && e.level == level)
        {
            last.times += 1;
            last.at = SystemTime::now();
            return false;
        }
        self.entries.push(LogEntry {
            level,
            text,
            at: SystemTime::now(),
            times: 1,
        });
        if self.entries.len() > MAX_MESSAGES {
            self.entries.remove(0);
        }
        true
    }

    /// All messages.
    pub fn entries(&self) -> &[LogEntry] {
        &self.entries
    }

    /// Removes all messages.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// All messages as text, oldest first.
    pub fn text(&self) -> String {
        self.entries
            .iter()
            .map(|e| format!("{:?}: {}\n", e.level, e.text))
            .collect()
    }
}
