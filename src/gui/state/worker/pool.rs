//! The thread pool for background work.

/// A thread pool for work that must not slow down the interface: all cores but one.
pub fn quiet_pool() -> Option<rayon::ThreadPool> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    rayon::ThreadPoolBuilder::new()
        .num_threads(cores.saturating_sub(1).max(1))
        .build()
        .ok()
}
