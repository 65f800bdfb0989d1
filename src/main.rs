//! The `incise` program.

fn main() -> std::process::ExitCode {
    incise::cli::main()
}
