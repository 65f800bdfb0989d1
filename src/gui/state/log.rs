//! What the program had to say: a list that stays, and toasts for what is new.

use std::time::SystemTime;

/// How much it matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    /// Good to know.
    Info,
    /// Something was done otherwise than asked.
    Warning,
    /// Something was not done.
    Error,
}

/// One message.
#[derive(Clone, Debug)]
pub struct LogEntry {
    /// How much it matters.
    pub level: LogLevel,
    /// What it says.
    pub text: String,
    /// When.
    pub at: SystemTime,
    /// How often in a row.
    pub times: usize,
}

/// Messages, oldest first.
#[derive(Default)]
pub struct Log {
    entries: Vec<LogEntry>,
}

/// Messages that are kept.
const MAX_MESSAGES: usize = 500;

impl Log {
    /// Adds one; false if it is the last one over again.
    pub fn add(&mut self, level: LogLevel, text: impl Into<String>) -> bool {
        let text = text.into();
        if let Some(last) = self.entries.last_mut().filter(|e| e.text == text && e.level == level) {
            last.times += 1;
            last.at = SystemTime::now();
            return false;
        }
        self.entries.push(LogEntry { level, text, at: SystemTime::now(), times: 1 });
        if self.entries.len() > MAX_MESSAGES {
            self.entries.remove(0);
        }
        true
    }

    /// All of them.
    pub fn entries(&self) -> &[LogEntry] {
        &self.entries
    }

    /// Forgets them.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// All as text, oldest first.
    pub fn text(&self) -> String {
        self.entries.iter().map(|e| format!("{:?}: {}\n", e.level, e.text)).collect()
    }
}
