//! Files in and files out, and the promises that hold for all of them:
//!
//! - **Nothing that is read is ever written.** Whatever [`input`] opens is noted in [`inputs`] by device and inode; an [`OutputFile`] that would
//!   replace one of these files is refused, whatever name or link leads to it.
//! - **Nothing is written by halves.** An [`OutputFile`] is made beside its destination and renamed into place when it is complete. What an
//!   interrupted run leaves behind is removed by [`unfinished`].
//! - **What is no ordinary file is left what it is.** Pipes, sockets and devices are written through, never replaced; as inputs they are refused,
//!   since a reader needs a length and a device has no end.
//! - **Nothing is read without a bound.** Texts have a largest size, compressed streams a largest growth, large arrays are refused while there is
//!   memory left to say so ([`memory`]).
//! - **A file does not reach outside its own folder** unless the user allows it ([`mod@reference`]).

pub mod input;
pub mod inputs;
pub mod memory;
mod output;
pub mod path_text;
pub mod reference;
pub mod unfinished;

pub use output::{OutputFile, check_distinct, standard_output};
