//! File input and output, with guarantees that hold for every reader and writer:
//!
//! - **An input is never overwritten.** Every file that [`input`] opens is registered in [`inputs`]
//!   by device and inode; an [`OutputFile`] that would replace one of these files is refused,
//!   whatever name or link leads to it.
//! - **No file is written partially.** An [`OutputFile`] is created next to its destination and
//!   renamed into place when it is complete, and so is an [`OutputFolder`]. Remains of an
//!   interrupted run are removed by [`unfinished`].
//! - **Only regular files are replaced.** Pipes, sockets and devices are written to, never
//!   replaced. As inputs they are refused, since a reader needs a length and a device has no end.
//! - **Every read is bounded.** Texts have a maximum size, compressed streams a maximum expansion,
//!   and large arrays are refused while there is still enough memory to report it ([`memory`]).
//! - **A file does not refer to files outside its own folder** unless the user allows it
//!   ([`mod@reference`]).

pub mod input;
pub mod inputs;
pub mod memory;
mod output;
mod output_folder;
pub mod path_text;
pub mod reference;
pub mod unfinished;

pub use output::{OutputFile, check_distinct, standard_output};
pub use output_folder::{OutputFolder, names_folder};
