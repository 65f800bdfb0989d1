//! Panics. Third-party decoders may panic on damaged data: behind [`catch_panic`] they can neither
//! end the program nor print a panic message. A fault of this program itself is reported in one
//! line, however many threads run into it, and may end the program at once ([`on_panic`]).

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, Once, OnceLock, PoisonError};
use std::time::{Duration, Instant};

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Number of active guards: threads doing work for them may panic on their behalf.
static UP: AtomicUsize = AtomicUsize::new(0);

type Respond = Box<dyn Fn(&str) + Send + Sync>;

/// How the program responds to its own faults.
static RESPOND: OnceLock<Respond> = OnceLock::new();

/// When the last fault was reported: many threads run into the same one.
static LAST_REPORT: Mutex<Option<Instant>> = Mutex::new(None);
const REPORT_INTERVAL: Duration = Duration::from_secs(2);

fn install() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let default = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if GUARDED.get() {
                return;
            }
            match RESPOND.get() {
                None => default(info),
                // The caller that installed the guard reports what is wrong with the data.
                Some(_) if UP.load(Ordering::SeqCst) > 0 => {}
                Some(respond) => {
                    let mut last_report = LAST_REPORT.lock().unwrap_or_else(PoisonError::into_inner);
                    if last_report.is_none_or(|t| t.elapsed() > REPORT_INTERVAL) {
                        *last_report = Some(Instant::now());
                        respond(&line(info));
                    }
                }
            }
        }));
    });
}

fn line(info: &PanicHookInfo) -> String {
    let place = info
        .location()
        .map_or_else(String::new, |l| format!(" at {}:{}", l.file(), l.line()));
    let what = info
        .payload_as_str()
        .unwrap_or("an unknown fault")
        .replace(char::is_control, " ");
    format!("internal error{place}: {what}; please report it, with the command and the scene")
}

/// From this call on, a fault of the program is passed to `respond` once, as one line, instead of
/// being printed by every thread. For programs; only the first call has an effect.
pub fn on_panic(respond: impl Fn(&str) + Send + Sync + 'static) {
    install();
    let _only_the_first = RESPOND.set(Box::new(respond));
}

/// Runs a decoder; `None` if it panicked.
pub(crate) fn catch_panic<T>(decode: impl FnOnce() -> T) -> Option<T> {
    install();
    let before = GUARDED.replace(true);
    UP.fetch_add(1, Ordering::SeqCst);
    let result = catch_unwind(AssertUnwindSafe(decode));
    UP.fetch_sub(1, Ordering::SeqCst);
    GUARDED.set(before);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_stays_inside() {
        assert_eq!(catch_panic(|| 3), Some(3));
        assert_eq!(catch_panic(|| -> u8 { panic!("quiet") }), None);
    }
}
